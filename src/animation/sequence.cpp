#include "vertex_files.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <system_error>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/core/error.h"
#include "freetalk/mesh/mesh.h"
#include "mesh/mesh_file.h"

namespace freetalk::animation {
namespace {

namespace fs = std::filesystem;

std::string frame_name(int64_t index, const std::string& extension) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "frame_%05lld", static_cast<long long>(index));
  return std::string(digits) + "." + extension;
}

/// Without the wait for the disk of an atomic write: frames are many, and their folder is renamed.
void write_frame(const fs::path& path, const std::string& bytes) {
  std::ofstream stream(path, std::ios::binary);
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  stream.close();
  FREETALK_RUNTIME_CHECK(stream, path.string(), ": writing failed (", std::strerror(errno), ")");
}

/// A folder that goes with everything in it when the scope ends.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(fs::path path) : path_(std::move(path)) {
    fs::create_directories(path_);
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

}  // namespace

SaveReport save_sequence(const fs::path& folder, const std::string& extension,
                         const Animation& animation, const SaveProgress& progress) {
  const fs::path target = fs::absolute(folder.empty() ? "." : folder).lexically_normal();
  const fs::path clean = target.has_filename() ? target : target.parent_path();
  try {
    FREETALK_RUNTIME_CHECK(!fs::exists(clean) || fs::is_directory(clean), folder.string(),
                           ": is a file; give a folder for the frames");
    // Within a folder that is there: the one around it may be protected.
    const fs::path around = fs::exists(clean) ? clean : clean.parent_path();
    const TemporaryFolder temporary(
        core::unused_neighbour(around / ("." + clean.filename().string())));
    mesh::Mesh frame = animation.mesh;
    for (int64_t t = 0; t < animation.num_frames(); ++t) {
      frame.vertices = animation.vertices_at(t);
      write_frame(temporary.path() / frame_name(t, extension), mesh::mesh_bytes(frame, extension));
      if (progress) progress(static_cast<double>(t + 1) / animation.num_frames());
    }
    fs::create_directories(clean);
    for (int64_t t = 0; t < animation.num_frames(); ++t) {
      const std::string name = frame_name(t, extension);
      fs::rename(temporary.path() / name, clean / name);
    }
    for (int64_t t = animation.num_frames(); fs::remove(clean / frame_name(t, extension)); ++t) {
    }
  } catch (const fs::filesystem_error& error) {
    FREETALK_RUNTIME_CHECK(false, folder.string(), ": can't be written (", error.code().message(),
                           "); choose another folder");
  }
  SaveReport report;
  report.format = extension;
  report.num_files = animation.num_frames();
  return report;
}

Animation load_sequence(const fs::path& folder, double fps) {
  FREETALK_RUNTIME_CHECK(fs::is_directory(folder), folder.string(),
                         " is not a folder of meshes, one a frame");
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string extension = core::lower_extension(entry.path());
    if (extension == "obj" || extension == "ply") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  FREETALK_RUNTIME_CHECK(!files.empty(), folder.string(), " holds no OBJ or PLY files");
  Animation animation;
  animation.fps = fps;
  animation.mesh = mesh::load_mesh(files.front());
  const int64_t vertices = animation.mesh.num_vertices();
  const auto frames = static_cast<int64_t>(files.size());
  animation.displacements = core::scratch_tensor({frames, vertices, 3});
  for (int64_t t = 0; t < frames; ++t) {
    const mesh::Mesh frame = mesh::load_mesh(files[t]);
    FREETALK_RUNTIME_CHECK(frame.num_vertices() == vertices, files[t].string(), " has ",
                           frame.num_vertices(), " vertices, ", files.front().string(), " ",
                           vertices, ": they are no frames of one mesh");
    const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> moved =
        (frame.vertices - animation.mesh.vertices).cast<float>();
    animation.displacements[t].copy_(
        at::from_blob(const_cast<float*>(moved.data()), {vertices, 3}, at::kFloat));
  }
  animation.check();
  return animation;
}

}  // namespace freetalk::animation
