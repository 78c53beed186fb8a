// Rigs and their poses as files.
#include <ATen/ATen.h>

#include <sstream>

#include "freetalk/core/cache_dir.h"
#include "freetalk/core/error.h"
#include "freetalk/core/log.h"
#include "freetalk/core/options.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/rig/face_rig.h"
#include "geometry/content_hash.h"

namespace freetalk::rig {
namespace {

namespace fs = std::filesystem;

// Raise when rigs are made differently: older entries of the cache are then never read again.
constexpr const char* kVersion = "1";

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : "\n") + name;
  return text;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

const std::string& entry(const core::SafetensorsFile& file, const std::string& key) {
  const auto found = file.metadata().find(key);
  FREETALK_RUNTIME_CHECK(found != file.metadata().end(), file.path().string(), ": no '", key,
                         "' in its metadata; it is not what is expected here");
  return found->second;
}

void check_format(const core::SafetensorsFile& file, const std::string& format) {
  const std::string &found = entry(file, "format"), &version = entry(file, "version");
  FREETALK_RUNTIME_CHECK(found == format && version == kVersion, file.path().string(),
                         ": expected ", format, " version ", kVersion, ", found ", found,
                         " version ", version);
}

at::Tensor floats(const core::SafetensorsFile& file, const std::string& key) {
  return file.tensor(key).to(at::kFloat, /*non_blocking=*/false, /*copy=*/true);
}

/// Calls `body`; what does not fit inside a file is the file's fault.
template <class Body>
auto naming(const fs::path& path, const Body& body) {
  try {
    return body();
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(core::join(path.string(), ": ", error.what()));
  }
}

std::string key_of(const std::string& content, const RigPoses& poses, const RigOptions& options) {
  geometry::ContentHash hash;
  const auto add = [&hash](const std::string& text) {
    const auto size = static_cast<int64_t>(text.size());
    hash.update(&size, sizeof(size));
    hash.update(text.data(), text.size());
  };
  for (const std::string& text :
       {std::string(kVersion), content, joined(poses.names), core::options_to_json(options)}) {
    add(text);
  }
  for (const at::Tensor& tensor : {poses.shapes, poses.library}) {
    const at::Tensor values = tensor.to(at::kCPU, at::kFloat).contiguous();
    hash.update(values.sizes().data(), values.sizes().size() * sizeof(int64_t));
    hash.update(values.const_data_ptr<float>(), values.nbytes());
  }
  return hash.hex();
}

}  // namespace

RigPoses RigPoses::load(const std::filesystem::path& path) {
  const core::SafetensorsFile file(path);
  check_format(file, "freetalk-rig-poses");
  RigPoses poses{lines_of(entry(file, "names")), floats(file, "shapes"), floats(file, "library")};
  naming(path, [&] { poses.check(); });
  return poses;
}

FaceRig FaceRig::load(const std::filesystem::path& path) {
  const core::SafetensorsFile file(path);
  check_format(file, "freetalk-rig");
  FaceRig rig;
  rig.names_ = lines_of(entry(file, "names"));
  rig.targets_ = floats(file, "targets");
  rig.shapes_ = floats(file, "shapes");
  rig.nodes_ = floats(file, "nodes");
  rig.node_fields_ = file.tensor("node_fields").clone();
  rig.shape_fields_ = file.tensor("shape_fields").clone();
  rig.scales_ = file.tensor("scales").clone();
  naming(path, [&] {
    core::options_from_json(rig.options_, entry(file, "options"), "rig");
    rig.prepare();
  });
  return rig;
}

void FaceRig::save(const std::filesystem::path& path) const {
  core::save_safetensors(path,
                         {{"targets", targets_},
                          {"shapes", shapes_},
                          {"nodes", nodes_},
                          {"node_fields", node_fields_},
                          {"shape_fields", shape_fields_},
                          {"scales", scales_}},
                         {{"format", "freetalk-rig"},
                          {"version", kVersion},
                          {"names", joined(names_)},
                          {"options", core::options_to_json(options_)}});
}

FaceRig FaceRig::cached(const std::string& content, const std::filesystem::path& cache_dir,
                        const Decode& decode, const RigPoses& poses, const RigOptions& options,
                        const std::function<void(double)>& progress) {
  options.check();
  poses.check();
  // Beside the operators, whose cache keeps the folder's size within bounds.
  const fs::path folder = (cache_dir.empty() ? core::default_cache_dir() : cache_dir) / "operators";
  const fs::path file = folder / ("rig-" + key_of(content, poses, options) + ".safetensors");
  std::error_code error;
  if (fs::exists(file, error)) {
    try {
      FaceRig rig = load(file);
      fs::last_write_time(file, fs::file_time_type::clock::now(), error);  // Used last now.
      return rig;
    } catch (const std::exception& fault) {
      core::log(
          core::LogLevel::kWarning,
          core::join(file.string(), ": made again, for the entry is damaged: ", fault.what()));
    }
  }
  FaceRig rig = build(decode, poses, options, progress);
  try {
    rig.save(file);
  } catch (const std::runtime_error& fault) {
    // A folder that cannot be written to costs the time next time, not the result.
    core::log(core::LogLevel::kWarning,
              core::join("the rig of a face is not kept: ", fault.what()));
  }
  return rig;
}

}  // namespace freetalk::rig
