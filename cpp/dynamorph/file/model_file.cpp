// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/file/model_file.hpp"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <tuple>

#include "dynamorph/core/sha256.hpp"
#include "dynamorph/reduced/modes/table_layout.hpp"

namespace dynamorph::file {

namespace {

using Json = nlohmann::json;  // not ordered_json, whose destructors allocate more often while it grows

const std::string kFormat = "dynamorph model";
constexpr int kOldest = 2, kVersion = 4;
constexpr std::uint64_t kMaxHeader = 16 << 20;  ///< bytes
constexpr int kMaxDepth = 8;                    ///< levels of nested JSON
constexpr int kMaxParts = 1 << 14;         ///< values in the JSON: enough for a thousand arrays; a model has twenty
constexpr std::size_t kMaxDimensions = 8;  ///< of an array
constexpr std::int64_t kMaxModes = 10000;  ///< for which the number of coefficients does not overflow

Error damaged(const std::string& how) { return Error("The model is damaged: " + how + ". Build it again."); }

/// Parses a JSON object. Throws Error when the text is not one.
Json parsed(const char* begin, const char* end) {
  int parts = 0;
  const auto limited = [&parts](int depth, Json::parse_event_t, Json&) {
    if (depth > kMaxDepth || ++parts > kMaxParts) throw damaged("its header is not readable");
    return true;
  };
  try {
    Json value = Json::parse(begin, end, limited);
    if (value.is_object()) return value;
  } catch (const Json::exception&) {
  }
  throw damaged("its header is not readable");
}

std::string text_of(const Json& metadata, const char* name) {
  const Json value = metadata.value(name, Json());
  if (!value.is_string()) throw damaged("its header is not readable");
  return value.get<std::string>();
}

/// Whether the header ends with its own hash, that of its bytes without the hash and the padding.
bool has_its_hash(const std::string& raw) {
  constexpr std::size_t kDigits = 64, kClosing = 3;  // the closing characters are "}}
  std::string text = raw.substr(0, raw.find_last_not_of(' ') + 1);
  if (text.size() < kDigits + kClosing) return false;
  const std::size_t at = text.size() - kClosing - kDigits;
  const std::string hash = text.substr(at, kDigits);
  text.erase(at, kDigits);
  return hash == sha256(text.data(), text.size());
}

struct Header {
  Json arrays, metadata;
  std::size_t end;  ///< where the data begin
};

Header read_header(const unsigned char* bytes, std::size_t size) {
  if (size < 8) throw Error("The model is cut off. Build it again.");
  std::uint64_t length = 0;
  for (int i = 0; i < 8; ++i) length |= std::uint64_t(bytes[i]) << 8 * i;
  if (length > kMaxHeader)
    throw Error("This is not a Dynamorph model, or it is damaged: its header has an impossible length.");
  if (length > size - 8) throw Error("The model is cut off. Build it again.");
  const std::string raw(reinterpret_cast<const char*>(bytes) + 8, std::size_t(length));
  Header header{parsed(raw.data(), raw.data() + raw.size()), {}, 8 + raw.size()};
  header.metadata = header.arrays.value("__metadata__", Json());
  header.arrays.erase("__metadata__");
  if (!header.metadata.is_object() || header.metadata.value("format", Json()) != kFormat)
    throw Error("This is not a Dynamorph model.");
  const Json version = header.metadata.value("version", Json());
  bool known = false;
  for (int readable = kOldest; readable <= kVersion; ++readable) known |= version == std::to_string(readable);
  if (!known)
    throw Error("The model has version " + (version.is_string() ? version.get<std::string>() : version.dump()) +
                ", but this add-on reads " + std::to_string(kOldest) + " to " + std::to_string(kVersion) +
                ". Build it again, or update the add-on.");
  if (!has_its_hash(raw)) throw damaged("its header has changed");
  return header;
}

/// Bytes per number; 0 for an unknown type.
std::uint64_t size_of(const std::string& dtype) {
  if (dtype == "BOOL") return 1;
  for (const char* kind : {"F64", "F32", "I64", "I32", "I16", "I8", "U64", "U32", "U16", "U8"})
    if (dtype == kind) return std::stoull(dtype.substr(1)) / 8;
  return 0;
}

/// Whether `value` is an array of integers >= 0.
bool are_counts(const Json& value) {
  return value.is_array() &&
         std::all_of(value.begin(), value.end(), [](const Json& n) { return n.is_number_unsigned(); });
}

/// The names of the arrays as their bytes follow each other; those without a place come first, and are refused.
std::vector<std::string> in_order_of_bytes(const Json& arrays) {
  std::vector<std::tuple<std::uint64_t, std::uint64_t, std::string>> places;
  for (const auto& [name, entry] : arrays.items()) {
    const Json offsets = entry.is_object() ? entry.value("data_offsets", Json()) : Json();
    if (are_counts(offsets) && offsets.size() == 2)
      places.emplace_back(offsets[0].get<std::uint64_t>(), offsets[1].get<std::uint64_t>(), name);
    else
      places.emplace_back(0, 0, name);
  }
  std::sort(places.begin(), places.end());
  std::vector<std::string> names;
  for (auto& place : places) names.push_back(std::move(std::get<2>(place)));
  return names;
}

/// The array that a header entry describes, without its bytes. Sets `size` to their number. They must start at `begin`
/// and fit in the `available` bytes of a file of `file_size`.
Array described(const std::string& name, const Json& entry, std::uint64_t begin, std::uint64_t available,
                std::uint64_t file_size, std::uint64_t& size) {
  const Error wrong = damaged("the table entry of array '" + name + "' is wrong");
  if (!entry.is_object() || entry.size() != 3) throw wrong;
  for (const char* key : {"dtype", "shape", "data_offsets"})
    if (!entry.contains(key)) throw wrong;
  const Json &dtype = entry["dtype"], &shape = entry["shape"], &offsets = entry["data_offsets"];
  if (!dtype.is_string() || !are_counts(shape) || !are_counts(offsets)) throw wrong;
  if (offsets.size() != 2 || shape.size() > kMaxDimensions) throw wrong;
  Array array{dtype.get<std::string>(), {}, {}};
  if (!size_of(array.dtype)) throw wrong;

  // The product of the nonzero dimensions is bounded for an empty array too, because strides are such products.
  std::uint64_t product = size_of(array.dtype);
  bool empty = false, impossible = false;
  for (const Json& value : shape) {
    const auto count = value.get<std::uint64_t>();
    empty |= count == 0;
    impossible |= count > file_size;  // of an empty array: somebody might allocate, or count, as many of something
    impossible |= count > std::uint64_t(std::numeric_limits<std::int64_t>::max()) / product;
    if (!impossible) product *= std::max<std::uint64_t>(count, 1);
    array.shape.push_back(std::int64_t(count));
  }
  if (!empty && (impossible || product > available - begin)) throw wrong;
  size = empty ? 0 : product;
  if (offsets[0] != begin || offsets[1] != begin + size) throw wrong;
  if (impossible) throw damaged("array '" + name + "' has an impossible shape");
  return array;
}

// --- Older versions --------------------------------------------------------------------------------------------------

/// For each coefficient that version 3 stores (`unfolded`), its place in version 2. Version 2 stored K0 as pairs k <= l
/// of modes, rows first, then K1 (modes, pairs), then the upper triangle of K2 (pairs, pairs), rows first.
std::vector<Eigen::Index> distinct_of_version_2(const TableLayout& layout) {
  const Eigen::Index r = layout.r;
  std::vector<Eigen::Index> places;
  for_pairs(r, [&](auto k, auto l) { places.push_back(pair_index(r, k, l)); });
  for_triples(
      r, [&](auto k, auto l, auto m) { places.push_back(layout.linear() + m * layout.pairs() + pair_index(r, k, l)); });
  for_quadruples(r, [&](auto k, auto l, auto m, auto n) {
    places.push_back(layout.quadratic(pair_index(r, k, l), pair_index(r, m, n)));
  });
  return places;
}

/// Converts a table of version 2 to version 3, bit for bit. modes: columns of the basis.
void keep_distinct(const std::string& name, std::int64_t modes, Array& table) {
  const Error wrong = Error("The model is damaged: '" + name + "' does not fit its " + std::to_string(modes) +
                            " modes. Build it again.");
  if (table.shape.empty() || modes > kMaxModes) throw wrong;
  const TableLayout layout{Eigen::Index(modes), true};
  if (table.shape.back() <= layout.pairs()) return;  // a table of the linear law, or none
  if (table.shape.size() != 2 || table.shape[1] != layout.size()) throw wrong;
  const auto size = std::ptrdiff_t(size_of(table.dtype));
  std::vector<unsigned char> kept;
  if (table.shape[0]) {
    kept.reserve(std::size_t(table.shape[0] * layout.distinct() * size));
    const std::vector<Eigen::Index> places = distinct_of_version_2(layout);
    for (std::int64_t row = 0; row < table.shape[0]; ++row)
      for (Eigen::Index place : places) {
        const auto number = table.bytes.begin() + (row * layout.size() + place) * size;
        kept.insert(kept.end(), number, number + size);
      }
  }
  table.shape[1] = layout.distinct();
  table.bytes = std::move(kept);
}

void bring_up_to_date(int version, Content& content) {
  const auto find = [&content](const char* name) {
    return std::find_if(content.arrays.begin(), content.arrays.end(), [&](const auto& a) { return a.first == name; });
  };
  if (version == 2) {
    const Array* basis = content.find("basis");
    const std::int64_t modes = basis && basis->shape.size() > 1 ? basis->shape[1] : 0;
    for (const char* name : {"table_lambda", "table_mu"})
      if (const auto table = find(name); table != content.arrays.end()) keep_distinct(name, modes, table->second);
  }
  const Array* tets = content.find("tets");
  if (version > 3 || !tets || tets->shape.empty()) return;
  const std::vector<double> ones(tets->bytes.empty() ? 0 : std::size_t(tets->shape[0]), 1.0);  // nothing was painted
  Array stiffness{"F64", {std::int64_t(ones.size())}, {}};
  stiffness.bytes.resize(sizeof(double) * ones.size());
  if (!ones.empty()) std::memcpy(stiffness.bytes.data(), ones.data(), stiffness.bytes.size());
  if (const auto present = find("stiffness"); present != content.arrays.end())
    present->second = std::move(stiffness);
  else
    content.arrays.emplace_back("stiffness", std::move(stiffness));
}

}  // namespace

const Array* Content::find(const std::string& name) const {
  for (const auto& [stored_name, array] : arrays)
    if (stored_name == name) return &array;
  return nullptr;
}

Content unpack(const unsigned char* bytes, std::size_t size) {
  const Header header = read_header(bytes, size);
  const unsigned char* data = bytes + header.end;
  const std::uint64_t available = size - header.end;
  const std::string hash_text = text_of(header.metadata, "hashes");
  const Json hashes = parsed(hash_text.data(), hash_text.data() + hash_text.size());
  Content content{{}, text_of(header.metadata, "meta")};
  std::uint64_t begin = 0, count = 0;
  for (const std::string& name : in_order_of_bytes(header.arrays)) {
    Array array = described(name, header.arrays[name], begin, available, size, count);
    array.bytes.assign(data + begin, data + begin + count);
    if (hashes.value(name, Json()) != sha256(array.bytes.data(), array.bytes.size()))
      throw damaged("array '" + name + "' has changed");
    content.arrays.emplace_back(name, std::move(array));
    begin += count;
  }
  if (begin != available) throw damaged("there are bytes after its end");
  bring_up_to_date(std::stoi(header.metadata["version"].get<std::string>()), content);
  return content;
}

Content read(const std::filesystem::path& path) {
  std::error_code unknown;
  const std::uintmax_t size = std::filesystem::file_size(path, unknown);
  std::ifstream stream(path, std::ios::binary);
  std::vector<unsigned char> bytes(unknown ? 0 : std::size_t(size));
  stream.read(reinterpret_cast<char*>(bytes.data()), std::streamsize(bytes.size()));
  if (unknown || !stream) throw Error("The model file '" + path.u8string() + "' cannot be read");
  return unpack(bytes.data(), bytes.size());
}

}  // namespace dynamorph::file
