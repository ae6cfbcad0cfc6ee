// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/file/model_file.hpp"

#include <algorithm>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <tuple>

#include "dynamorph/core/sha256.hpp"

namespace dynamorph::file {

namespace {

using Json = nlohmann::json;  // not ordered_json, whose destructors allocate more often while it grows

const std::string kFormat = "dynamorph model";
const std::string kVersion = "1";
constexpr std::uint64_t kMaxHeader = 16 << 20;  ///< bytes
constexpr int kMaxDepth = 8;                    ///< levels of nested JSON
constexpr int kMaxParts = 1 << 14;         ///< values in the JSON: enough for a thousand arrays; a model has twenty
constexpr std::size_t kMaxDimensions = 8;  ///< of an array

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
  if (version != kVersion)
    throw Error("The model has version " + (version.is_string() ? version.get<std::string>() : version.dump()) +
                ", but this Dynamorph reads version " + kVersion + ". Build it again, or update Dynamorph.");
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
