// Point cache of Blender and 3ds Max: a header of 32 bytes and the vertices of every frame,
// float32.
#include <ATen/ATen.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/core/error.h"
#include "vertex_files.h"

namespace freetalk::animation {
namespace {

static_assert(std::endian::native == std::endian::little, "the file is little-endian, as we are");

struct Header {
  char magic[12] = {'P', 'O', 'I', 'N', 'T', 'C', 'A', 'C', 'H', 'E', '2', '\0'};
  int32_t version = 1;
  int32_t num_points = 0;
  float start_frame = 0.0f;
  float sample_rate = 1.0f;  // frames a sample
  int32_t num_samples = 0;
};
static_assert(sizeof(Header) == 32);

constexpr double kOtherUnit = 4.0;  // ratio of sizes from which a mesh is not the one that moves

}  // namespace

SaveReport save_pc2(const std::filesystem::path& path, const Animation& animation,
                    const SaveProgress& progress) {
  Header header;
  header.num_points = static_cast<int32_t>(animation.mesh.num_vertices());
  header.num_samples = static_cast<int32_t>(animation.num_frames());
  core::write_file_atomic(path, [&](std::ostream& out) {
    out.write(reinterpret_cast<const char*>(&header), sizeof(header));
    for (int64_t t = 0; t < animation.num_frames(); ++t) {
      const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> rows =
          animation.vertices_at(t).cast<float>();
      out.write(reinterpret_cast<const char*>(rows.data()),
                static_cast<std::streamsize>(rows.size() * sizeof(float)));
      if (progress) progress(static_cast<double>(t + 1) / animation.num_frames());
    }
  });
  return SaveReport{"pc2"};
}

Animation load_pc2(const std::filesystem::path& path, const mesh::Mesh& mesh, double fps) {
  FREETALK_RUNTIME_CHECK(std::filesystem::is_regular_file(path), path.string(),
                         " does not exist; check the path");
  std::ifstream in(path, std::ios::binary);
  Header header;
  const Header expected;
  in.read(reinterpret_cast<char*>(&header), sizeof(header));
  FREETALK_RUNTIME_CHECK(in && std::memcmp(header.magic, expected.magic, 12) == 0, path.string(),
                         " is no PC2 cache");
  const int64_t points = header.num_points, frames = header.num_samples;
  FREETALK_RUNTIME_CHECK(points == mesh.num_vertices(), path.string(), " moves ", points,
                         " vertices; the mesh has ", mesh.num_vertices());
  const auto size = static_cast<int64_t>(std::filesystem::file_size(path));
  FREETALK_RUNTIME_CHECK(frames > 0 && size >= 32 + 12 * points * frames, path.string(),
                         " is damaged or cut short; write it again");
  Animation animation;
  animation.mesh = mesh;
  animation.fps = fps;
  animation.displacements = core::scratch_tensor({frames, points, 3});
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> rest = mesh.vertices.cast<float>();
  const auto still = at::from_blob(const_cast<float*>(rest.data()), {points, 3}, at::kFloat);
  for (int64_t t = 0; t < frames; ++t) {
    const auto frame = animation.displacements[t];
    in.read(static_cast<char*>(frame.data_ptr()), 12 * points);
    if (t == 0) {
      const double held = (frame.amax(0) - frame.amin(0)).norm().item<double>();
      const double own = (still.amax(0) - still.amin(0)).norm().item<double>();
      FREETALK_RUNTIME_CHECK(held < kOtherUnit * own && own < kOtherUnit * held, path.string(),
                             " holds a face of size ", held, ", the mesh's is ", own,
                             ": give the mesh in the cache's own unit");
    }
    frame.sub_(still);
  }
  animation.check();
  return animation;
}

}  // namespace freetalk::animation
