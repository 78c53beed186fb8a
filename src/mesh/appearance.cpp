#include "freetalk/mesh/appearance.h"

#include <algorithm>
#include <cctype>
#include <locale>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>

#include "core/file.h"
#include "mesh/gltf_buffers.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// A file beside `owner` or below; of a path into another folder, as other machines leave them, the
/// file of that name beside `owner`. @returns an empty path where there is none.
fs::path neighbour(const fs::path& owner, std::string name) {
  std::replace(name.begin(), name.end(), '\\', '/');
  fs::path relative = fs::path(name).lexically_normal();
  std::error_code error;
  const bool inside = !relative.is_absolute() && !relative.empty() && *relative.begin() != "..";
  if (inside && fs::is_regular_file(owner.parent_path() / relative, error)) {
    return owner.parent_path() / relative;
  }
  const fs::path beside = owner.parent_path() / relative.filename();
  return fs::is_regular_file(beside, error) ? beside : fs::path();
}

/// Empty where the bytes are no PNG or JPEG.
Texture texture_of(const std::string& name, std::string bytes) {
  Texture texture{name, "", std::move(bytes)};
  if (texture.bytes.compare(0, 4, "\x89PNG") == 0) texture.media_type = "image/png";
  if (texture.bytes.compare(0, 3, "\xFF\xD8\xFF") == 0) texture.media_type = "image/jpeg";
  return texture.media_type.empty() ? Texture() : texture;
}

/// Empty where there is no such file, or it is no PNG or JPEG.
Texture read_texture(const fs::path& owner, const std::string& name) {
  const fs::path path = neighbour(owner, name);
  return path.empty() ? Texture() : texture_of(path.filename().string(), core::read_text(path));
}

/// The picture of a texture by its index; empty where it is of another kind or not there.
Texture gltf_texture(const GltfDocument& document, int64_t index) {
  const json& texture = document.list("textures").at(static_cast<size_t>(index));
  if (!texture.contains("source")) return {};
  const json& images = document.list("images");
  const int64_t number = document.index(texture, "source", images.size());
  const json& image = images[static_cast<size_t>(number)];
  const std::string bytes = image.contains("uri")
                                ? document.content_of(image.at("uri").get<std::string>())
                                : document.view_bytes(document.whole(image, "bufferView"));
  Texture found = texture_of("texture" + std::to_string(number), bytes);
  found.name += found.media_type == "image/png" ? ".png" : ".jpg";
  return found;
}

std::vector<Material> gltf_materials(const fs::path& source) {
  const GltfDocument document(source, core::read_text(source));
  std::vector<Material> materials;
  for (const json& entry : document.list("materials")) {
    Material& material = materials.emplace_back();
    material.name = entry.value("name", "material" + std::to_string(materials.size()));
    const json& look = entry.value("pbrMetallicRoughness", json::object());
    if (look.contains("baseColorFactor")) {
      material.colour = Eigen::Vector4d(document.numbers(look, "baseColorFactor", 4).data());
    }
    if (!look.contains("baseColorTexture")) continue;
    const json& texture = look.at("baseColorTexture");
    material.texture =
        gltf_texture(document, document.index(texture, "index", document.list("textures").size()));
  }
  return materials;
}

/// Options of a texture take a known number of words: "-s 1 1 1 -clamp on skin.png".
std::string texture_name(std::istringstream& words) {
  static const std::map<std::string, int> kArguments = {
      {"-blendu", 1}, {"-blendv", 1}, {"-bm", 1},        {"-boost", 1},
      {"-cc", 1},     {"-clamp", 1},  {"-imfchan", 1},   {"-mm", 2},
      {"-texres", 1}, {"-type", 1},   {"-colorspace", 1}};
  std::string word, name;
  while (words >> word) {
    const auto known = kArguments.find(word);
    if (known != kArguments.end()) {
      for (int k = 0; k < known->second; ++k) words >> word;
    } else if (word == "-o" || word == "-s" || word == "-t") {  // one to three numbers
      while (words >> std::ws && (std::isdigit(words.peek()) || words.peek() == '.' ||
                                  words.peek() == '-' || words.peek() == '+')) {
        const auto before = words.tellg();
        double number = 0.0;
        if (!(words >> number)) {
          words.clear();
          words.seekg(before);
          break;
        }
      }
    } else {
      std::getline(words, name);
      name = word + name;
    }
  }
  return name.substr(0, name.find_last_not_of(" \t\r") + 1);
}

/// Adds the materials of an MTL file to those that are missing in `found`.
void read_library(const fs::path& path, std::map<std::string, Material>& found) {
  std::istringstream lines(core::read_text(path));
  lines.imbue(std::locale::classic());
  Material* material = nullptr;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    words.imbue(std::locale::classic());
    std::string keyword;
    words >> keyword;
    if (keyword == "newmtl") {
      std::string name;
      std::getline(words >> std::ws, name);
      name.erase(name.find_last_not_of(" \t\r") + 1);
      material = &found[name];
      material->name = name;
    } else if (material == nullptr) {
      continue;
    } else if (keyword == "Kd") {
      Eigen::Vector3d colour;
      if (words >> colour[0] >> colour[1] >> colour[2]) {
        material->colour.head<3>() = colour.cwiseMax(0.0).cwiseMin(1.0);
      }
    } else if (keyword == "d" || keyword == "Tr") {
      double value = 1.0;
      if (words >> value) {
        material->colour[3] = std::clamp(keyword == "d" ? value : 1.0 - value, 0.0, 1.0);
      }
    } else if (keyword == "map_Kd") {
      material->texture = read_texture(path, texture_name(words));
    }
  }
}

std::vector<Material> obj_materials(const fs::path& source, const RawMesh& raw) {
  std::map<std::string, Material> found;
  for (const std::string& library : raw.material_files) {
    const fs::path path = neighbour(source, library);
    if (!path.empty()) read_library(path, found);
  }
  std::vector<Material> materials;
  for (const std::string& name : raw.materials) {
    materials.push_back(found[name]);
    materials.back().name = name;
  }
  return materials;
}

}  // namespace

Appearance load_appearance(const Mesh& mesh) {
  Appearance appearance;
  const std::string extension = core::lower_extension(mesh.source);
  std::error_code error;
  const bool gltf = extension == "glb" || extension == "gltf";
  const bool readable =
      (gltf || extension == "obj" || extension == "ply") && fs::is_regular_file(mesh.source, error);
  if (!readable) return appearance;
  RawMesh raw;
  std::vector<Material> materials;
  try {
    raw = read_raw_mesh(mesh.source);
    if (gltf) materials = gltf_materials(mesh.source);
  } catch (const std::exception&) {  // another file by now, or a picture that is not there
    return appearance;
  }
  std::vector<int> polygon_material;
  int64_t polygons = 0;
  for (size_t p = 0; p < raw.polygons.size(); ++p) {
    if (raw.polygons[p].size() < 3) continue;
    if (!raw.polygon_material.empty()) polygon_material.push_back(raw.polygon_material[p]);
    ++polygons;
  }
  const auto vertices = static_cast<int64_t>(raw.vertices.size());
  if (polygons != mesh.num_polygons() || vertices != mesh.num_vertices()) return appearance;
  appearance.colours.resize(static_cast<Eigen::Index>(raw.colours.size()), 4);
  for (size_t v = 0; v < raw.colours.size(); ++v) {
    appearance.colours.row(static_cast<Eigen::Index>(v)) = raw.colours[v];
  }
  if (gltf || extension == "obj") {
    appearance.materials = gltf ? std::move(materials) : obj_materials(mesh.source, raw);
    appearance.polygon_material = std::move(polygon_material);
  } else if (!raw.material_files.empty()) {
    Texture texture = read_texture(mesh.source, raw.material_files.front());
    if (!texture.bytes.empty()) {
      appearance.materials.push_back({"skin", Eigen::Vector4d::Ones(), std::move(texture)});
      appearance.polygon_material.assign(static_cast<size_t>(polygons), 0);
    }
  }
  return appearance;
}

}  // namespace freetalk::mesh
