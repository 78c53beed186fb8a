#include "usda.h"

#include <ATen/ATen.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <map>

#include "core/file.h"
#include "file_metadata.h"
#include "freetalk/mesh/appearance.h"
#include "head_track.h"
#include "morph_normals.h"
#include "sound.h"
#include "usda_text.h"

namespace freetalk::animation {
namespace {

namespace fs = std::filesystem;

at::Tensor points_of(const mesh::Mesh& mesh) {
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> rows = mesh.vertices.cast<float>();
  return at::from_blob(const_cast<float*>(rows.data()), {rows.rows(), 3}, at::kFloat).clone();
}

std::string texture_folder(const fs::path& path) { return path.stem().string() + ".textures"; }

class Layer {
 public:
  Layer(std::ostream& out, const fs::path& path, const Animation& animation,
        const BlendShapes& shapes, const SaveOptions& options, const mesh::Appearance& look)
      : text_(out),
        path_(path),
        animation_(animation),
        shapes_(shapes),
        options_(options),
        look_(look),
        normals_(animation.mesh) {}

  void write() {
    header();
    text_ << "def SkelRoot \"Face\" (\n    prepend apiSchemas = [\"SkelBindingAPI\"]\n)\n{\n";
    placement();
    if (has_skeleton()) skeleton();
    surface();
    materials();
    if (options_.sound && !animation_.audio.samples.empty()) sound();
    text_ << "}\n";
  }

 private:
  void header() {
    text_ << "#usda 1.0\n(\n    customLayerData = {\n        string freetalk = "
          << quoted(metadata_in_metres(animation_).dump())
          << "\n    }\n    defaultPrim = \"Face\"\n"
          << "    endTimeCode = " << animation_.num_frames() - 1
          << "\n    framesPerSecond = " << animation_.fps
          << "\n    metersPerUnit = 1\n    startTimeCode = 0\n    timeCodesPerSecond = "
          << animation_.fps << "\n    upAxis = \"Y\"\n)\n\n";
  }

  /// USD multiplies rows by matrices.
  void placement() {
    const Eigen::Matrix3d linear =
        animation_.frame.metres_per_unit * animation_.frame.to_y_up.transpose();
    text_ << "    matrix4d xformOp:transform = ( ";
    for (int r = 0; r < 3; ++r) {
      text_ << "(" << linear(r, 0) << ", " << linear(r, 1) << ", " << linear(r, 2) << ", 0), ";
    }
    text_ << "(0, 0, 0, 1) )\n    uniform token[] xformOpOrder = [\"xformOp:transform\"]\n\n";
  }

  void names_of_shapes(const char* before, const char* after) {
    text_.list(static_cast<int64_t>(shapes_.names.size()),
               [&](int64_t k) { text_ << before << identifier(shapes_.names[k]) << after; });
  }

  bool has_skeleton() const { return !shapes_.names.empty() || animation_.head.defined(); }

  /// One joint, which is the head, and what moves over time.
  void skeleton() {
    const char* identity = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )";
    text_ << "    def Skeleton \"Skeleton\" (\n        prepend apiSchemas = [\"SkelBindingAPI\"]\n"
          << "    )\n    {\n        uniform matrix4d[] bindTransforms = [" << identity << "]\n"
          << "        uniform token[] joints = [\"root\"]\n"
          << "        uniform matrix4d[] restTransforms = [" << identity << "]\n"
          << "        rel skel:animationSource = </Face/Skeleton/Talk>\n\n"
          << "        def SkelAnimation \"Talk\"\n        {\n"
          << "            uniform token[] joints = [\"root\"]\n"
          << "            half3[] scales = [(1, 1, 1)]\n";
    joint();
    if (!shapes_.names.empty()) weights();
    text_ << "        }\n    }\n\n";
  }

  template <class Sample>
  void samples(const char* name, const Sample& sample) {
    text_ << "            " << name << ".timeSamples = {\n";
    for (int64_t t = 0; t < animation_.num_frames(); ++t) {
      text_ << "                " << t << ": ";
      sample(t);
      text_ << ",\n";
    }
    text_ << "            }\n";
  }

  void joint() {
    if (!animation_.head.defined()) {
      text_ << "            quatf[] rotations = [(1, 0, 0, 0)]\n"
            << "            float3[] translations = [(0, 0, 0)]\n";
      return;
    }
    const HeadTrack head = head_track(animation_.head, MeshFrame{});  // below the placement
    samples("quatf[] rotations", [&](int64_t t) {
      const float* q = head.turns.data_ptr<float>() + 4 * t;
      text_ << "[(" << q[3] << ", " << q[0] << ", " << q[1] << ", " << q[2] << ")]";
    });
    samples("float3[] translations",
            [&](int64_t t) { text_.rows(head.shifts.slice(0, t, t + 1)); });
  }

  void weights() {
    text_ << "            uniform token[] blendShapes = ";
    names_of_shapes("\"", "\"");
    text_ << "\n";
    const auto weights = shapes_.weights.contiguous();
    const int64_t count = weights.size(1);
    samples("float[] blendShapeWeights", [&](int64_t t) {
      const float* row = weights.data_ptr<float>() + t * count;
      text_.list(count, [&](int64_t k) { text_ << row[k]; });
    });
  }

  void surface() {
    const auto& mesh = animation_.mesh;
    const int64_t polygons = mesh.num_polygons();
    text_ << "    def Mesh \"Surface\" (\n        prepend apiSchemas = [\"SkelBindingAPI\", "
          << "\"MaterialBindingAPI\"]\n    )\n    {\n        int[] faceVertexCounts = ";
    text_.list(polygons, [&](int64_t p) { text_ << mesh.polygon(p).size(); });
    text_ << "\n        int[] faceVertexIndices = ";
    bool first = true;
    text_ << "[";
    for (int64_t p = 0; p < polygons; ++p) {
      for (const int v : mesh.polygon(p)) {
        text_ << (first ? "" : ", ") << v;
        first = false;
      }
    }
    text_ << "]\n        point3f[] points = ";
    text_.rows(points_of(mesh));
    text_ << "\n        normal3f[] normals = ";
    text_.rows(normals_.rest()) << " (\n            interpolation = \"vertex\"\n        )\n"
                                << "        uniform token subdivisionScheme = \"none\"\n"
                                << "        uniform bool doubleSided = 1\n";
    texcoords();
    colours();
    if (has_skeleton()) skinning();
    if (!shapes_.names.empty()) shapes();
    bindings();
    text_ << "    }\n\n";
  }

  void texcoords() {
    const auto& mesh = animation_.mesh;
    if (mesh.texcoords.rows() == 0 || mesh.polygon_texcoords.empty()) return;
    text_ << "        texCoord2f[] primvars:st = ";
    text_.list(mesh.texcoords.rows() + 1, [&](int64_t i) {  // the last for corners without
      const bool own = i < mesh.texcoords.rows();
      text_ << "(" << (own ? mesh.texcoords(i, 0) : 0.0) << ", "
            << (own ? mesh.texcoords(i, 1) : 0.0) << ")";
    });
    text_ << " (\n            interpolation = \"faceVarying\"\n        )\n"
          << "        int[] primvars:st:indices = [";
    bool first = true;
    for (int64_t p = 0; p < mesh.num_polygons(); ++p) {
      const auto corners = mesh.polygon(p).size();
      const auto& rows = mesh.polygon_texcoords[p];
      for (size_t c = 0; c < corners; ++c) {
        const bool own = rows.size() == corners;
        text_ << (first ? "" : ", ")
              << (own ? static_cast<int64_t>(rows[c]) : mesh.texcoords.rows());
        first = false;
      }
    }
    text_ << "]\n";
  }

  void colours() {
    const bool own = look_.colours.rows() > 0;
    text_ << "        color3f[] primvars:displayColor = ";
    if (own) {
      text_.list(look_.colours.rows(), [&](int64_t v) {
        text_ << "(" << look_.colours(v, 0) << ", " << look_.colours(v, 1) << ", "
              << look_.colours(v, 2) << ")";
      });
      text_ << " (\n            interpolation = \"vertex\"\n        )\n";
    } else {
      text_ << "[(0.8, 0.64, 0.56)]\n";
    }
  }

  void skinning() {
    const int64_t vertices = animation_.mesh.num_vertices();
    text_ << "        rel skel:skeleton = </Face/Skeleton>\n"
          << "        int[] primvars:skel:jointIndices = ";
    text_.list(vertices, [&](int64_t) { text_ << 0; });
    text_ << " (\n            elementSize = 1\n            interpolation = \"vertex\"\n"
          << "        )\n        float[] primvars:skel:jointWeights = ";
    text_.list(vertices, [&](int64_t) { text_ << 1; });
    text_ << " (\n            elementSize = 1\n            interpolation = \"vertex\"\n        )\n";
  }

  void shapes() {
    text_ << "        uniform token[] skel:blendShapes = ";
    names_of_shapes("\"", "\"");
    text_ << "\n        rel skel:blendShapeTargets = ";
    names_of_shapes("</Face/Surface/", ">");
    text_ << "\n";
    for (size_t k = 0; k < shapes_.names.size(); ++k) {
      const auto target = shapes_.targets[static_cast<int64_t>(k)];
      text_ << "\n        def BlendShape \"" << identifier(shapes_.names[k])
            << "\"\n        {\n            uniform vector3f[] offsets = ";
      text_.rows(target);
      if (options_.normals) {
        text_ << "\n            uniform vector3f[] normalOffsets = ";
        text_.rows(normals_.derivative(target));
      }
      text_ << "\n        }\n";
    }
  }

  void bindings() {
    std::map<int, std::vector<int64_t>> polygons;
    for (size_t p = 0; p < look_.polygon_material.size(); ++p) {
      polygons[look_.polygon_material[p]].push_back(static_cast<int64_t>(p));
    }
    if (polygons.size() > 1) {
      text_ << "        uniform token subsetFamily:materialBind:familyType = \"partition\"\n";
    }
    for (const auto& [material, own] : polygons) {
      const std::string name = name_of(material);
      const std::string bind = "rel material:binding = </Face/Materials/" + name + ">\n";
      if (polygons.size() == 1) {
        text_ << "        " << bind;
        continue;
      }
      text_ << "\n        def GeomSubset \"" << name
            << "\" (\n            prepend apiSchemas = [\"MaterialBindingAPI\"]\n        )\n"
            << "        {\n            uniform token elementType = \"face\"\n"
            << "            uniform token familyName = \"materialBind\"\n"
            << "            int[] indices = ";
      text_.list(static_cast<int64_t>(own.size()),
                 [&, &faces = own](int64_t i) { text_ << faces[i]; });
      text_ << "\n            " << bind << "        }\n";
    }
  }

  std::string name_of(int material) const {
    if (material < 0) return "material_none";
    return "material_" + std::to_string(material) + "_" +
           identifier(look_.materials[material].name);
  }

  void materials() {
    if (look_.materials.empty()) return;
    text_ << "    def Scope \"Materials\"\n    {\n";
    for (int m = 0; m < static_cast<int>(look_.materials.size()); ++m) {
      material(name_of(m), look_.materials[m]);
    }
    const auto& used = look_.polygon_material;
    if (std::find(used.begin(), used.end(), -1) != used.end()) {
      mesh::Material skin;
      skin.colour = Eigen::Vector4d(0.80, 0.64, 0.56, 1.0);
      material(name_of(-1), skin);
    }
    text_ << "    }\n\n";
  }

  void material(const std::string& name, const mesh::Material& look) {
    const std::string here = "/Face/Materials/" + name;
    const bool textured = !look.texture.bytes.empty();
    const auto& c = look.colour;
    text_ << "        def Material \"" << name << "\"\n        {\n"
          << "            token outputs:surface.connect = <" << here
          << "/Shader.outputs:surface>\n\n"
          << "            def Shader \"Shader\"\n            {\n"
          << "                uniform token info:id = \"UsdPreviewSurface\"\n"
          << "                color3f inputs:diffuseColor";
    if (textured) {
      text_ << ".connect = <" << here << "/Texture.outputs:rgb>\n";
    } else {
      text_ << " = (" << c[0] << ", " << c[1] << ", " << c[2] << ")\n";
    }
    text_ << "                float inputs:opacity = " << c[3] << "\n"
          << "                float inputs:roughness = 0.7\n"
          << "                token outputs:surface\n            }\n";
    if (textured) {
      text_ << "\n            def Shader \"Texture\"\n            {\n"
            << "                uniform token info:id = \"UsdUVTexture\"\n"
            << "                asset inputs:file = @./" << texture_folder(path_) << "/"
            << look.texture.name << "@\n"
            << "                float4 inputs:scale = (" << c[0] << ", " << c[1] << ", " << c[2]
            << ", 1)\n                token inputs:sourceColorSpace = \"sRGB\"\n"
            << "                token inputs:wrapS = \"repeat\"\n"
            << "                token inputs:wrapT = \"repeat\"\n"
            << "                float2 inputs:st.connect = <" << here
            << "/Coordinates.outputs:result>\n                float3 outputs:rgb\n"
            << "            }\n\n            def Shader \"Coordinates\"\n            {\n"
            << "                uniform token info:id = \"UsdPrimvarReader_float2\"\n"
            << "                string inputs:varname = \"st\"\n"
            << "                float2 outputs:result\n            }\n";
    }
    text_ << "        }\n";
  }

  void sound() {
    text_ << "    def SpatialAudio \"Speech\"\n    {\n        uniform token auralMode = "
          << "\"nonSpatial\"\n        uniform asset filePath = @./"
          << sound_beside(path_).filename().string()
          << "@\n        uniform token playbackMode = \"onceFromStart\"\n    }\n";
  }

  UsdText text_;
  const fs::path& path_;
  const Animation& animation_;
  const BlendShapes& shapes_;
  const SaveOptions& options_;
  const mesh::Appearance& look_;
  const MorphNormals normals_;
};

}  // namespace

SaveReport save_usda(const fs::path& path, const Animation& animation, const BlendShapes& shapes,
                     const SaveOptions& options) {
  const mesh::Appearance look = mesh::load_appearance(animation.mesh);
  SaveReport report;
  report.format = "usda";
  std::map<std::string, bool> written;
  for (const auto& material : look.materials) {
    const auto& texture = material.texture;
    if (texture.bytes.empty() || !written.try_emplace(texture.name, true).second) continue;
    const fs::path folder = path.parent_path() / texture_folder(path);
    core::write_file_atomic(folder / texture.name, texture.bytes);
  }
  core::write_file_atomic(
      path, [&](std::ostream& out) { Layer(out, path, animation, shapes, options, look).write(); });
  report.num_files += static_cast<int64_t>(written.size());
  report.num_morph_targets = shapes.targets.size(0);
  report.morph_error_mm = 1e3 * animation.frame.metres_per_unit * shapes.max_error;
  return report;
}

}  // namespace freetalk::animation
