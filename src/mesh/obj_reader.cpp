// OBJ text to RawMesh. Not OpenMesh's reader: that one drops a line "v nan 0 0" (which shifts every
// index after it), rounds to float and keeps no texture coordinate indices.
#include <algorithm>
#include <charconv>
#include <limits>
#include <string_view>

#include "core/number.h"
#include "freetalk/core/error.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

constexpr int kInvalidIndex = -1;

class ObjParser {
 public:
  ObjParser(const std::filesystem::path& path, std::string_view text) : path_(path), text_(text) {}

  RawMesh parse() {
    while (position_ < text_.size()) {
      std::string_view line = next_line();
      const std::string_view keyword = next_token(line);
      if (keyword == "v") {
        Eigen::Vector3d& point = mesh_.vertices.emplace_back();
        for (int axis = 0; axis < 3; ++axis)
          point[axis] = number(line, "a vertex needs three numbers");
        colour(line);
      } else if (keyword == "vt") {
        Eigen::Vector2d& texcoord = mesh_.texcoords.emplace_back(0.0, 0.0);
        texcoord[0] = number(line, "a texture coordinate needs a number");
        if (!blank(line)) texcoord[1] = number(line, "a texture coordinate is not a number");
      } else if (keyword == "f") {
        face(line);
      } else if (keyword == "usemtl") {
        material_ = material(rest_of(line));
      } else if (keyword == "mtllib") {
        mesh_.material_files.push_back(rest_of(line));
      } else if (keyword == "l" || keyword == "p") {
        ++mesh_.lines_and_points;
      }
    }
    if (mesh_.colours.size() != mesh_.vertices.size()) mesh_.colours.clear();
    if (mesh_.materials.empty()) mesh_.polygon_material.clear();
    if (!any_texcoords_) {
      mesh_.texcoords.clear();
      mesh_.polygon_texcoords.clear();
    }
    return std::move(mesh_);
  }

 private:
  /// The next line; lines that end in a backslash are joined with the one below.
  std::string_view next_line() {
    ++line_number_;
    const size_t begin = position_;
    size_t end = text_.find('\n', begin);
    if (end == std::string_view::npos) end = text_.size();
    position_ = end + 1;
    std::string_view line = text_.substr(begin, end - begin);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    if (line.empty() || line.back() != '\\') return line.substr(0, line.find('#'));
    joined_.clear();
    while (!line.empty() && line.back() == '\\') {
      joined_.append(line.substr(0, line.size() - 1)).push_back(' ');
      if (position_ >= text_.size()) return joined_;
      ++line_number_;
      end = std::min(text_.find('\n', position_), text_.size());
      line = text_.substr(position_, end - position_);
      position_ = end + 1;
      if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    }
    joined_.append(line);
    return std::string_view(joined_).substr(0, joined_.find('#'));
  }

  static bool blank(std::string_view line) {
    return line.find_first_not_of(" \t") == std::string_view::npos;
  }

  static std::string_view next_token(std::string_view& line) {
    const size_t begin = std::min(line.find_first_not_of(" \t"), line.size());
    const size_t end = std::min(line.find_first_of(" \t", begin), line.size());
    const std::string_view token = line.substr(begin, end - begin);
    line.remove_prefix(end);
    return token;
  }

  /// What is left of a line, a name that may hold spaces.
  static std::string rest_of(std::string_view line) {
    const size_t begin = std::min(line.find_first_not_of(" \t"), line.size());
    const size_t end = line.find_last_not_of(" \t") + 1;
    return std::string(line.substr(begin, std::max(begin, end) - begin));
  }

  int material(const std::string& name) {
    const auto found = std::find(mesh_.materials.begin(), mesh_.materials.end(), name);
    const auto index = static_cast<int>(found - mesh_.materials.begin());
    if (found == mesh_.materials.end()) mesh_.materials.push_back(name);
    return index;
  }

  /// Three numbers after the position are a colour, as ZBrush and MeshLab write it.
  void colour(std::string_view line) {
    Eigen::Vector4d values(0.0, 0.0, 0.0, 1.0);
    for (int channel = 0; channel < 3; ++channel) {
      const std::string_view token = next_token(line);
      const auto [end, error] =
          core::parse_number(token.data(), token.data() + token.size(), values[channel]);
      if (token.empty() || error != std::errc()) return;
    }
    mesh_.colours.push_back(values.cwiseMax(0.0).cwiseMin(1.0));
  }

  double number(std::string_view& line, const char* problem) {
    std::string_view token = next_token(line);
    if (!token.empty() && token.front() == '+') token.remove_prefix(1);
    double value = 0.0;
    const auto [end, error] = core::parse_number(token.data(), token.data() + token.size(), value);
    FREETALK_RUNTIME_CHECK(error == std::errc() && end == token.data() + token.size(), "mesh file ",
                           path_.string(), " line ", line_number_, ": ", problem,
                           "; export the mesh again as OBJ");
    return value;
  }

  /// 0-based index from a 1-based or negative (relative) one; kInvalidIndex for anything else but
  /// an empty field.
  int index(std::string_view field, size_t count) const {
    int64_t value = 0;
    const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
    FREETALK_RUNTIME_CHECK(error == std::errc() && end == field.data() + field.size(), "mesh file ",
                           path_.string(), " line ", line_number_,
                           ": a face needs whole numbers as indices; export the mesh again as OBJ");
    const int64_t zero_based = value < 0 ? static_cast<int64_t>(count) + value : value - 1;
    const bool valid = zero_based >= 0 && zero_based < std::numeric_limits<int>::max();
    return valid ? static_cast<int>(zero_based) : kInvalidIndex;
  }

  void face(std::string_view line) {
    std::vector<int> polygon;
    std::vector<int> texcoords;
    for (std::string_view token = next_token(line); !token.empty(); token = next_token(line)) {
      const size_t slash = std::min(token.find('/'), token.size());
      polygon.push_back(index(token.substr(0, slash), mesh_.vertices.size()));
      if (slash == token.size()) continue;
      const std::string_view rest = token.substr(slash + 1);
      const std::string_view texcoord = rest.substr(0, rest.find('/'));
      if (!texcoord.empty()) texcoords.push_back(index(texcoord, mesh_.texcoords.size()));
    }
    if (texcoords.size() != polygon.size()) texcoords.clear();
    any_texcoords_ |= !texcoords.empty();
    mesh_.polygons.push_back(std::move(polygon));
    mesh_.polygon_texcoords.push_back(std::move(texcoords));
    mesh_.polygon_material.push_back(material_);
  }

  const std::filesystem::path& path_;
  std::string_view text_;
  std::string joined_;
  size_t position_ = 0;
  int64_t line_number_ = 0;
  bool any_texcoords_ = false;
  int material_ = -1;
  RawMesh mesh_;
};

}  // namespace

RawMesh read_obj(const std::filesystem::path& path, const std::string& text) {
  return ObjParser(path, text).parse();
}

}  // namespace freetalk::mesh
