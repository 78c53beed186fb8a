// PLY bytes to RawMesh: text and binary of either byte order, any scalar types, polygons of any
// size, texture coordinates at vertices or at face corners. Not OpenMesh's reader: that one rounds
// to float, drops corner texture coordinates and fills the rest with repetitions when a file is cut
// short.
#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstring>
#include <limits>
#include <locale>
#include <sstream>
#include <string_view>

#include "core/number.h"
#include "freetalk/core/error.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

enum class Scalar { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

struct Property {
  std::string name;
  Scalar type;
  bool is_list = false;
  Scalar count_type = Scalar::kUint8;
};

struct Element {
  std::string name;
  int64_t count = 0;
  std::vector<Property> properties;
};

bool scalar_of(const std::string& name, Scalar& type) {
  constexpr std::pair<const char*, Scalar> kNames[] = {
      {"char", Scalar::kInt8},     {"int8", Scalar::kInt8},     {"uchar", Scalar::kUint8},
      {"uint8", Scalar::kUint8},   {"short", Scalar::kInt16},   {"int16", Scalar::kInt16},
      {"ushort", Scalar::kUint16}, {"uint16", Scalar::kUint16}, {"int", Scalar::kInt32},
      {"int32", Scalar::kInt32},   {"uint", Scalar::kUint32},   {"uint32", Scalar::kUint32},
      {"float", Scalar::kFloat},   {"float32", Scalar::kFloat}, {"double", Scalar::kDouble},
      {"float64", Scalar::kDouble}};
  for (const auto& [known, value] : kNames) {
    if (name == known) {
      type = value;
      return true;
    }
  }
  return false;
}

class PlyParser {
 public:
  PlyParser(const std::string& file, std::string_view bytes) : file_(file), bytes_(bytes) {}

  RawMesh parse() {
    header();
    for (const Element& element : elements_) {
      for (int64_t i = 0; i < element.count; ++i) read(element);
    }
    if (has_corner_texcoords_) {
      mesh_.texcoords = std::move(corner_texcoords_);
    } else if (has_vertex_texcoords_) {
      mesh_.polygon_texcoords = mesh_.polygons;
    } else {
      mesh_.texcoords.clear();
      mesh_.polygon_texcoords.clear();
    }
    return std::move(mesh_);
  }

 private:
  [[noreturn]] void fail(const std::string& problem) const {
    throw std::runtime_error("mesh file " + file_ + " " + problem);
  }

  void header() {
    constexpr const char* kNotPly = "is not a PLY file; check it or export it again";
    if (bytes_.substr(0, 3) != "ply") fail(kNotPly);
    for (bool first = true;; first = false) {
      const size_t end = bytes_.find('\n', position_);
      if (end == std::string_view::npos) fail(kNotPly);
      std::istringstream words(std::string(bytes_.substr(position_, end - position_)));
      words.imbue(std::locale::classic());
      position_ = end + 1;
      std::string keyword, name;
      words >> keyword >> name;
      if (keyword == "end_header") break;
      if (keyword == "format") {
        text_ = name == "ascii";
        swap_ = name == "binary_big_endian" && std::endian::native == std::endian::little;
        if (!text_ && name != "binary_little_endian" && name != "binary_big_endian") fail(kNotPly);
      } else if (keyword == "element") {
        Element& element = elements_.emplace_back(Element{name, -1, {}});
        words >> element.count;
      } else if (keyword == "property") {
        if (elements_.empty()) fail(kNotPly);
        elements_.back().properties.push_back(property(name, words));
      } else if (keyword == "comment" && name == "TextureFile") {
        std::string file;
        std::getline(words >> std::ws, file);
        if (!file.empty() && file.back() == '\r') file.pop_back();
        mesh_.material_files.push_back(file);
      } else if (!first && keyword != "comment" && keyword != "obj_info" && !keyword.empty()) {
        fail(kNotPly);
      }
    }
    check_counts();
  }

  Property property(const std::string& first, std::istringstream& words) {
    Property result;
    std::string type = first;
    if (first == "list") {
      std::string count;
      words >> count >> type;
      result.is_list = true;
      if (!scalar_of(count, result.count_type))
        fail("has properties of unknown type; export it again");
    }
    if (!scalar_of(type, result.type)) fail("has properties of unknown type; export it again");
    words >> result.name;
    return result;
  }

  void check_counts() {
    bool vertices = false, faces = false;
    for (const Element& element : elements_) {
      // Every element takes at least a byte, so a larger count is damage (or an attack on the
      // memory).
      if (element.count < 0 || element.count > static_cast<int64_t>(bytes_.size())) {
        fail("promises more elements than it can hold; export it again");
      }
      if (element.properties.empty() && element.count > 0) fail("is damaged; export it again");
      vertices |= element.name == "vertex";
      faces |= element.name == "face" && element.count > 0;
    }
    if (!vertices) fail("has no vertices; choose a PLY with vertices and faces");
    if (!faces) fail("has no faces; choose a mesh, not a point cloud");
  }

  void read(const Element& element) {
    const bool is_vertex = element.name == "vertex";
    const bool is_face = element.name == "face";
    if (is_vertex) {
      mesh_.vertices.emplace_back(0.0, 0.0, 0.0);
      mesh_.texcoords.emplace_back(0.0, 0.0);
    }
    values_.clear();
    std::vector<int> polygon;
    std::vector<double> texcoords;
    for (const Property& property : element.properties) {
      if (!property.is_list) {
        const double value = number(property.type);
        if (is_vertex) set_vertex(property, value);
        continue;
      }
      const double count = number(property.count_type);
      if (!(count >= 0.0 && count <= static_cast<double>(bytes_.size() - position_))) cut_short();
      values_.resize(static_cast<size_t>(count));
      for (double& value : values_) value = number(property.type);
      if (is_face && property.name.rfind("vertex_ind", 0) == 0) {
        for (const double value : values_) polygon.push_back(index(value));
      } else if (is_face && property.name == "texcoord") {
        texcoords = values_;
      }
    }
    if (is_face) add_face(std::move(polygon), texcoords);
  }

  void set_vertex(const Property& property, double value) {
    const std::string& name = property.name;
    const auto is = [&name](std::initializer_list<const char*> names) {
      return std::find(names.begin(), names.end(), name) != names.end();
    };
    if (name == "x") mesh_.vertices.back().x() = value;
    if (name == "y") mesh_.vertices.back().y() = value;
    if (name == "z") mesh_.vertices.back().z() = value;
    constexpr std::array<const char*, 4> kChannels = {"red", "green", "blue", "alpha"};
    const auto channel = std::find(kChannels.begin(), kChannels.end(), name);
    if (channel != kChannels.end()) {
      mesh_.colours.resize(mesh_.vertices.size(), Eigen::Vector4d(0.0, 0.0, 0.0, 1.0));
      const double scale = property.type == Scalar::kUint8 ? 255.0 : 1.0;
      mesh_.colours.back()[channel - kChannels.begin()] = std::clamp(value / scale, 0.0, 1.0);
    }
    if (is({"s", "u", "texture_u"})) mesh_.texcoords.back().x() = value;
    if (is({"t", "v", "texture_v"})) {
      mesh_.texcoords.back().y() = value;
      has_vertex_texcoords_ = true;
    }
  }

  void add_face(std::vector<int> polygon, const std::vector<double>& texcoords) {
    std::vector<int> corners;
    if (!polygon.empty() && texcoords.size() == 2 * polygon.size()) {
      has_corner_texcoords_ = true;
      for (size_t c = 0; c < polygon.size(); ++c) {
        corners.push_back(static_cast<int>(corner_texcoords_.size()));
        corner_texcoords_.emplace_back(texcoords[2 * c], texcoords[2 * c + 1]);
      }
    }
    mesh_.polygons.push_back(std::move(polygon));
    mesh_.polygon_texcoords.push_back(std::move(corners));
  }

  static int index(double value) {
    const bool valid = value >= 0.0 && value < std::numeric_limits<int>::max();
    return valid ? static_cast<int>(value) : -1;
  }

  [[noreturn]] void cut_short() const { fail("is damaged or cut short; export it again"); }

  double number(Scalar type) {
    if (text_) return text_number();
    switch (type) {
      case Scalar::kInt8:
        return binary<int8_t>();
      case Scalar::kUint8:
        return binary<uint8_t>();
      case Scalar::kInt16:
        return binary<int16_t>();
      case Scalar::kUint16:
        return binary<uint16_t>();
      case Scalar::kInt32:
        return binary<int32_t>();
      case Scalar::kUint32:
        return binary<uint32_t>();
      case Scalar::kFloat:
        return binary<float>();
      default:
        return binary<double>();
    }
  }

  template <class T>
  double binary() {
    if (bytes_.size() - position_ < sizeof(T)) cut_short();
    char raw[sizeof(T)];
    std::memcpy(raw, bytes_.data() + position_, sizeof(T));
    position_ += sizeof(T);
    if (swap_) std::reverse(raw, raw + sizeof(T));
    T value;
    std::memcpy(&value, raw, sizeof(T));
    return static_cast<double>(value);
  }

  double text_number() {
    constexpr std::string_view kBlank = " \t\r\n";
    position_ = std::min(bytes_.find_first_not_of(kBlank, position_), bytes_.size());
    if (position_ < bytes_.size() && bytes_[position_] == '+') ++position_;
    if (position_ >= bytes_.size()) cut_short();
    double value = 0.0;
    const char* end = bytes_.data() + bytes_.size();
    const auto [next, error] = core::parse_number(bytes_.data() + position_, end, value);
    if (error != std::errc()) {
      fail("has text where numbers are expected; export it again");
    }
    position_ = static_cast<size_t>(next - bytes_.data());
    return value;
  }

  const std::string& file_;
  std::string_view bytes_;
  size_t position_ = 0;
  bool text_ = true;
  bool swap_ = false;
  bool has_vertex_texcoords_ = false;
  bool has_corner_texcoords_ = false;
  std::vector<Element> elements_;
  std::vector<double> values_;
  std::vector<Eigen::Vector2d> corner_texcoords_;
  RawMesh mesh_;
};

}  // namespace

RawMesh read_ply(const std::filesystem::path& path, const std::string& bytes) {
  const std::string file = path.string();
  return PlyParser(file, bytes).parse();
}

}  // namespace freetalk::mesh
