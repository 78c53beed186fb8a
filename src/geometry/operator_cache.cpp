#include <ATen/ATen.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <vector>

#include "content_hash.h"
#include "freetalk/core/cache_dir.h"
#include "freetalk/core/error.h"
#include "freetalk/core/log.h"
#include "freetalk/core/options.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/geometry/operators.h"
#include "operators_faces.h"

namespace freetalk::geometry {
namespace {

namespace fs = std::filesystem;

// Raise when the operators of a mesh change: older entries are then never read again.
constexpr int kOperatorVersion = 3;

std::string key_of(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                   const OperatorOptions& options) {
  ContentHash hash;
  const int64_t header[4] = {kOperatorVersion, vertices.rows(), faces.rows(), vertices.cols()};
  hash.update(header, sizeof(header));
  hash.update(vertices.data(), sizeof(double) * static_cast<size_t>(vertices.size()));
  hash.update(faces.data(), sizeof(int) * static_cast<size_t>(faces.size()));
  const std::string text = core::options_to_json(options);
  hash.update(text.data(), text.size());
  return hash.hex();
}

std::string checksum(const core::TensorMap& tensors) {
  ContentHash hash;
  for (const auto& [name, tensor] : tensors) {
    const at::Tensor data = tensor.contiguous();
    const auto type = static_cast<int64_t>(data.scalar_type());
    hash.update(name.data(), name.size());
    hash.update(&type, sizeof(type));
    hash.update(data.sizes().data(), data.sizes().size() * sizeof(int64_t));
    hash.update(data.data_ptr(), data.nbytes());
  }
  return hash.hex();
}

core::TensorMap tensors_of(const SurfaceOperators& operators) {
  return {{"mass", operators.mass},
          {"evals", operators.evals},
          {"evecs", operators.evecs},
          {"normals", operators.normals},
          {"frames", operators.frames},
          {"residuals", operators.residuals},
          {"gradients.crow", operators.gradients.rows},
          {"gradients.col", operators.gradients.columns},
          {"gradients.values", operators.gradients.values}};
}

int64_t num_bytes(const core::TensorMap& tensors) {
  int64_t bytes = 0;
  for (const auto& item : tensors) bytes += static_cast<int64_t>(item.second.nbytes());
  return bytes;
}

/// The entry, or nothing if it is missing, damaged or of another shape.
std::optional<SurfaceOperators> load_entry(const fs::path& file, int64_t num_vertices, int64_t k) {
  std::error_code error;
  if (!fs::exists(file, error)) return std::nullopt;
  try {
    const core::SafetensorsFile entry(file);
    core::TensorMap tensors;
    for (const std::string& key : entry.keys()) tensors[key] = entry.tensor(key).clone();
    const auto sum = entry.metadata().find("checksum");
    FREETALK_RUNTIME_CHECK(sum != entry.metadata().end() && sum->second == checksum(tensors),
                           "its checksum differs");
    SurfaceOperators operators;
    operators.mass = tensors.at("mass");
    operators.evals = tensors.at("evals");
    operators.evecs = tensors.at("evecs");
    operators.normals = tensors.at("normals");
    operators.frames = tensors.at("frames");
    operators.residuals = tensors.at("residuals");
    operators.gradients = SparseOperator::from_rows(
        tensors.at("gradients.crow").to(at::kInt),  // older files: int64
        tensors.at("gradients.col").to(at::kInt), tensors.at("gradients.values"), num_vertices);
    FREETALK_RUNTIME_CHECK(operators.num_vertices() == num_vertices && operators.k_eig() == k,
                           "it is of another mesh");
    fs::last_write_time(file, fs::file_time_type::clock::now(), error);  // Used last now.
    return operators;
  } catch (const std::exception& error) {
    core::log(
        core::LogLevel::kWarning,
        core::join(file.string(), ": computed again, for the entry is damaged: ", error.what()));
    return std::nullopt;
  }
}

/// A file being written, or left by a process that was killed while it wrote.
bool is_temporary(const fs::path& file) {
  return file.filename().string().find(".tmp-") != std::string::npos;
}

/// Removes the entries unused for longest until the folder holds at most `max_bytes`, never `keep`.
void evict(const fs::path& folder, const fs::path& keep, int64_t max_bytes) {
  struct Entry {
    fs::path file;
    fs::file_time_type used;
    int64_t bytes;
  };
  std::vector<Entry> entries;
  int64_t total = 0;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;  // Another process may have removed it.
    const auto bytes = static_cast<int64_t>(it->file_size(gone));
    const auto used = it->last_write_time(gone);
    if (gone) continue;
    if (is_temporary(it->path())) {
      constexpr std::chrono::hours kAbandoned(1);  // Writing an entry takes seconds.
      if (fs::file_time_type::clock::now() - used > kAbandoned) fs::remove(it->path(), gone);
      continue;
    }
    entries.push_back({it->path(), used, bytes});
    total += bytes;
  }
  std::sort(entries.begin(), entries.end(),
            [](const Entry& a, const Entry& b) { return a.used < b.used; });
  for (const Entry& entry : entries) {
    if (total <= max_bytes) return;
    if (entry.file == keep) continue;
    fs::remove(entry.file, error);
    total -= entry.bytes;
  }
}

}  // namespace

std::filesystem::path default_cache_dir() { return core::default_cache_dir(); }

SurfaceOperators cached_surface_operators(const Eigen::MatrixXd& vertices,
                                          const Eigen::MatrixXi& faces,
                                          const OperatorOptions& options,
                                          const std::filesystem::path& cache_dir,
                                          const std::string& name, int64_t max_bytes,
                                          const std::function<void(double)>& progress) {
  const fs::path folder = (cache_dir.empty() ? default_cache_dir() : cache_dir) / "operators";
  const fs::path file = folder / (key_of(vertices, faces, options) + ".safetensors");
  if (auto cached = load_entry(file, vertices.rows(), options.k_eig)) {
    attach_faces(*cached, vertices, faces, options.weld != "none");
    return *std::move(cached);
  }
  SurfaceOperators operators = surface_operators(vertices, faces, options, name, progress);
  const core::TensorMap tensors = tensors_of(operators);
  if (num_bytes(tensors) > max_bytes) return operators;
  try {
    core::save_safetensors(file, tensors, {{"checksum", checksum(tensors)}});
    evict(folder, file, max_bytes);
  } catch (const std::runtime_error& error) {
    // A folder that cannot be written to (full, read-only) costs the time next time, not the
    // result.
    core::log(core::LogLevel::kWarning,
              core::join("operators of ", name, " are not kept: ", error.what()));
  }
  return operators;
}

}  // namespace freetalk::geometry
