#include "npz_animation.h"

#include <ATen/ATen.h>

#include <algorithm>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/core/error.h"
#include "npz.h"

namespace freetalk::animation {
namespace {

template <class T>
using RowMajor = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

void add_matrix(NpzWriter& writer, const std::string& name, const Eigen::MatrixXd& values) {
  const RowMajor<double> rows = values;
  writer.add(name, "<f8", {rows.rows(), rows.cols()}, rows.data());
}

/// Lists of different lengths as their sizes and one flat array.
void add_lists(NpzWriter& writer, const std::string& sizes_name, const std::string& name,
               const std::vector<std::vector<int>>& lists) {
  std::vector<int32_t> sizes, flat;
  for (const auto& list : lists) {
    sizes.push_back(static_cast<int32_t>(list.size()));
    flat.insert(flat.end(), list.begin(), list.end());
  }
  writer.add(sizes_name, "<i4", {static_cast<int64_t>(sizes.size())}, sizes.data());
  writer.add(name, "<i4", {static_cast<int64_t>(flat.size())}, flat.data());
}

std::vector<std::vector<int>> read_lists(NpzReader& reader, const std::string& sizes_name,
                                         const std::string& name, const std::string& where) {
  const auto sizes = reader.read<int>(sizes_name);
  const auto flat = reader.read<int>(name);
  std::vector<std::vector<int>> lists;
  size_t at = 0;
  for (const int size : sizes) {
    FREETALK_RUNTIME_CHECK(size >= 0 && at + size <= flat.size(), where, ": '", sizes_name,
                           "' doesn't fit '", name, "'");
    lists.emplace_back(flat.begin() + at, flat.begin() + at + size);
    at += size;
  }
  return lists;
}

template <class T>
RowMajor<T> read_matrix(NpzReader& reader, const std::string& name, int64_t columns,
                        const std::string& where) {
  const auto& shape = reader.at(name).shape;
  FREETALK_RUNTIME_CHECK(shape.size() == 2 && shape[1] == columns, where, ": '", name,
                         "' must be (N, ", columns, ")");
  const int64_t rows = shape[0];
  const auto values = reader.read<T>(name);
  return Eigen::Map<const RowMajor<T>>(values.data(), rows, columns);
}

mesh::Mesh read_mesh(NpzReader& reader, const std::string& where) {
  const Eigen::MatrixXd vertices = read_matrix<double>(reader, "vertices", 3, where);
  std::vector<std::vector<int>> polygons, polygon_texcoords;
  if (reader.contains("polygon_sizes")) {
    polygons = read_lists(reader, "polygon_sizes", "polygon_vertices", where);
  } else {
    const auto faces = read_matrix<int>(reader, "faces", 3, where);
    for (int64_t f = 0; f < faces.rows(); ++f) {
      polygons.push_back({faces(f, 0), faces(f, 1), faces(f, 2)});
    }
  }
  Eigen::MatrixXd texcoords;
  if (reader.contains("texcoords")) {
    texcoords = read_matrix<double>(reader, "texcoords", 2, where);
    polygon_texcoords = read_lists(reader, "texcoord_sizes", "polygon_texcoords", where);
  }
  const std::string name = reader.contains("name") ? reader.read_text("name") : "";
  try {
    return mesh::make_mesh(vertices, std::move(polygons), std::move(texcoords),
                           std::move(polygon_texcoords), name);
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(where + ": " + error.what());
  }
}

}  // namespace

void save_npz(const std::filesystem::path& path, const Animation& animation) {
  const auto& mesh = animation.mesh;
  core::write_file_atomic(path, [&](std::ostream& out) {
    NpzWriter writer(out);
    add_matrix(writer, "vertices", mesh.vertices);
    const RowMajor<int32_t> faces = mesh.faces;
    writer.add("faces", "<i4", {faces.rows(), 3}, faces.data());
    writer.add("displacements", "<f4", animation.displacements.sizes().vec(),
               animation.displacements.data_ptr<float>(),
               [&] { core::release_pages(animation.displacements); });
    writer.add_scalar("fps", animation.fps);
    writer.add("audio", "<f4", {static_cast<int64_t>(animation.audio.samples.size())},
               animation.audio.samples.data());
    writer.add_scalar("sample_rate_hz", animation.audio.sample_rate_hz);
    writer.add_text("metadata", animation.metadata_json);
    writer.add_text("name", mesh.name);
    writer.add_scalar("metres_per_unit", animation.frame.metres_per_unit);
    add_matrix(writer, "to_y_up", animation.frame.to_y_up);
    if (animation.head.defined()) {
      writer.add("head", "<f8", animation.head.sizes().vec(), animation.head.const_data_ptr());
    }
    if (animation.landmarks.defined()) {
      const auto landmarks = animation.landmarks.contiguous();
      writer.add("landmarks", "<f4", landmarks.sizes().vec(), landmarks.data_ptr<float>());
    }
    if (!mesh.polygons.empty()) {
      add_lists(writer, "polygon_sizes", "polygon_vertices", mesh.polygons);
    }
    if (mesh.texcoords.rows() > 0) {
      add_matrix(writer, "texcoords", mesh.texcoords);
      add_lists(writer, "texcoord_sizes", "polygon_texcoords", mesh.polygon_texcoords);
    }
    writer.finish();
  });
}

Animation load_npz(const std::filesystem::path& path) {
  const std::string where = path.string();
  NpzReader reader(path);
  Animation animation;
  animation.mesh = read_mesh(reader, where);
  const auto& shape = reader.at("displacements").shape;
  FREETALK_RUNTIME_CHECK(shape.size() == 3 && shape[0] > 0 &&
                             shape[1] == animation.mesh.num_vertices() && shape[2] == 3,
                         where, ": 'displacements' must be (T, ", animation.mesh.num_vertices(),
                         ", 3)");
  animation.displacements = core::scratch_tensor(shape);
  reader.read_raw("displacements", "<f4", animation.displacements.data_ptr());
  core::release_pages(animation.displacements);
  const auto scalar = [&](const std::string& name) {
    FREETALK_RUNTIME_CHECK(reader.at(name).count == 1, where, ": '", name, "' must be one number");
    return reader.read<double>(name).front();
  };
  animation.fps = scalar("fps");
  if (reader.contains("audio")) {
    animation.audio.samples = reader.read<float>("audio");
    const double rate = scalar("sample_rate_hz");
    FREETALK_RUNTIME_CHECK(rate >= audio::kMinSampleRateHz && rate <= audio::kMaxSampleRateHz,
                           where, ": 'sample_rate_hz' is ", rate);
    animation.audio.sample_rate_hz = static_cast<int64_t>(rate);
  }
  if (reader.contains("landmarks")) {
    const auto& motion = reader.at("landmarks").shape;
    const auto values = reader.read<float>("landmarks");
    animation.landmarks = at::tensor(values).view(motion);
  }
  if (reader.contains("metadata")) animation.metadata_json = reader.read_text("metadata");
  if (reader.contains("metres_per_unit")) {
    animation.frame.metres_per_unit = scalar("metres_per_unit");
  }
  if (reader.contains("to_y_up")) {
    const auto rows = read_matrix<double>(reader, "to_y_up", 3, where);
    FREETALK_RUNTIME_CHECK(rows.rows() == 3, where, ": 'to_y_up' must be (3, 3)");
    animation.frame.to_y_up = rows;
  }
  if (reader.contains("head")) {
    animation.head = at::empty(reader.at("head").shape, at::kDouble);
    reader.read_raw("head", "<f8", animation.head.data_ptr());
  }
  try {
    animation.check();
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(where + ": " + error.what());
  }
  return animation;
}

}  // namespace freetalk::animation
