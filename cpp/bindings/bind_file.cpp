// SPDX-License-Identifier: GPL-3.0-or-later
// Reads model files into NumPy arrays.
#include "bindings.hpp"
#include "dynamorph/file/model_file.hpp"

using namespace dynamorph;

namespace {

py::dtype numpy_type(const std::string& dtype) {
  if (dtype == "BOOL") return py::dtype("?");
  const std::string kind = dtype[0] == 'F' ? "f" : dtype[0] == 'I' ? "i" : "u";
  return py::dtype("<" + kind + std::to_string(std::stoi(dtype.substr(1)) / 8));
}

/// Takes over the memory that `array` owns.
py::array to_numpy(file::Array array) {
  const std::vector<py::ssize_t> shape(array.shape.begin(), array.shape.end());
  const py::dtype type = numpy_type(array.dtype);
  auto bytes = std::make_unique<std::vector<unsigned char>>(std::move(array.bytes));
  const void* data = bytes->data();
  const py::capsule owner(bytes.get(), [](void* p) { delete static_cast<std::vector<unsigned char>*>(p); });
  bytes.release();
  return py::array(type, shape, data, owner);
}

}  // namespace

void bind_file(py::module_& m) {
  m.def(
      "unpack_model",
      [](const py::buffer& buffer) {
        const py::buffer_info bytes = buffer.request();
        if (bytes.ndim != 1 || bytes.itemsize != 1 || (bytes.size > 1 && bytes.strides[0] != 1))
          throw std::invalid_argument("buffer: expected contiguous bytes");
        file::Content content;
        {
          py::gil_scoped_release release;
          content = file::unpack(static_cast<const unsigned char*>(bytes.ptr), std::size_t(bytes.size));
        }
        py::dict arrays;
        for (auto& [name, array] : content.arrays) arrays[py::str(name)] = to_numpy(std::move(array));
        return py::make_tuple(arrays, content.meta);
      },
      "buffer"_a,
      "Returns (arrays by name, description as JSON) from a model file's bytes. Raises Error when the bytes are "
      "damaged, or of a version that cannot be read.");
}
