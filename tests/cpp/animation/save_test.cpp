#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/animation/animation.h"
#include "scratch.h"

namespace freetalk::animation {
namespace {

using testing::ScratchFolder;
using testing::seam_animation;

TEST(Npz, KeepsEverythingBitForBit) {
  const ScratchFolder folder;
  const auto saved = seam_animation(7);
  EXPECT_EQ(saved.save(folder / "a.npz").format, "npz");
  const auto loaded = load_npz(folder / "a.npz");
  EXPECT_EQ(loaded.mesh.vertices, saved.mesh.vertices);
  EXPECT_EQ(loaded.mesh.faces, saved.mesh.faces);
  EXPECT_EQ(loaded.mesh.polygons, saved.mesh.polygons);
  EXPECT_EQ(loaded.mesh.texcoords, saved.mesh.texcoords);
  EXPECT_EQ(loaded.mesh.polygon_texcoords, saved.mesh.polygon_texcoords);
  EXPECT_EQ(loaded.mesh.name, saved.mesh.name);
  EXPECT_TRUE(at::equal(loaded.displacements, saved.displacements));
  EXPECT_EQ(loaded.fps, saved.fps);
  EXPECT_EQ(loaded.audio.samples, saved.audio.samples);
  EXPECT_EQ(loaded.audio.sample_rate_hz, saved.audio.sample_rate_hz);
  EXPECT_EQ(nlohmann::json::parse(loaded.metadata_json),
            nlohmann::json::parse(saved.metadata_json));
  EXPECT_EQ(loaded.frame.metres_per_unit, saved.frame.metres_per_unit);
  EXPECT_EQ(loaded.frame.to_y_up, saved.frame.to_y_up);
}

TEST(Npz, SameAnimationGivesTheSameBytes) {
  const ScratchFolder folder;
  seam_animation(7).save(folder / "a.npz");
  seam_animation(7).save(folder / "b.npz");
  EXPECT_EQ(core::read_text(folder / "a.npz"), core::read_text(folder / "b.npz"));
}

TEST(Npz, MotionInATemporaryFileIsSavedAlike) {
  const ScratchFolder folder;
  auto animation = seam_animation(7);
  animation.save(folder / "a.npz");
  animation.save(folder / "a.glb");
  const auto motion = core::scratch_tensor(animation.displacements.sizes(), 0);
  animation.displacements = motion.copy_(animation.displacements);
  animation.save(folder / "b.npz");
  animation.save(folder / "b.glb");
  EXPECT_EQ(core::read_text(folder / "a.npz"), core::read_text(folder / "b.npz"));
  EXPECT_EQ(core::read_text(folder / "a.glb"), core::read_text(folder / "b.glb"));
}

TEST(Npz, EveryTruncationIsAnErrorThatNamesTheFile) {
  const ScratchFolder folder;
  seam_animation(2).save(folder / "a.npz");
  const std::string bytes = core::read_text(folder / "a.npz");
  for (size_t size = 0; size < bytes.size(); size += 37) {
    core::write_file_atomic(folder / "cut.npz", bytes.substr(0, size));
    try {
      load_npz(folder / "cut.npz");
      FAIL() << "read " << size << " of " << bytes.size() << " bytes";
    } catch (const std::runtime_error& error) {
      EXPECT_NE(std::string(error.what()).find("cut.npz"), std::string::npos);
    }
  }
}

/// The archive with `from` replaced in a header, which keeps its length by dropping padding.
std::string with_claim(std::string bytes, const std::string& from, const std::string& to) {
  const size_t at = bytes.find(from), padding = bytes.find('}', at) + 1;
  bytes.replace(at, from.size(), to);
  if (to.size() < from.size())
    return bytes.insert(padding + to.size() - from.size(), from.size() - to.size(), ' ');
  return bytes.erase(padding + to.size() - from.size(), to.size() - from.size());
}

TEST(Npz, ClaimsBeyondTheFileAreRefusedBeforeRoomIsMade) {
  const ScratchFolder folder;
  seam_animation(2).save(folder / "a.npz");
  const std::string bytes = core::read_text(folder / "a.npz");
  const std::string shape = "'shape': (2, 6, 3)", type = "'<U";
  const size_t digits = bytes.find_first_not_of("0123456789", bytes.find(type) + 3);
  const std::string text = bytes.substr(bytes.find(type), digits - bytes.find(type));
  for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
           {shape, "'shape': (333333333, 6, 3)"},            // 24 GB
           {shape, "'shape': (4294967297, 4294967296, 3)"},  // more than 2^64 bytes
           {shape, "'shape': (99999999999999999999999, 6, 3)"},
           {text, "'<U9999999999"},
           {text, "'<U99999999999999999999999"}}) {
    core::write_file_atomic(folder / "claim.npz", with_claim(bytes, from, to));
    try {
      load_npz(folder / "claim.npz");
      FAIL() << to;
    } catch (const std::runtime_error& error) {
      EXPECT_NE(std::string(error.what()).find("claim.npz"), std::string::npos) << to;
    }
  }
}

TEST(Npz, MissingFileIsAnError) { EXPECT_THROW(load_npz("/nowhere/a.npz"), std::runtime_error); }

TEST(Sequence, WritesOneMeshPerFrameAndRemovesOlderFrames) {
  const ScratchFolder folder;
  seam_animation(5).save(folder / "frames/*.obj");
  const auto animation = seam_animation(3);
  const auto report = animation.save(folder / "frames/*.obj");
  EXPECT_EQ(report.num_files, 3);
  EXPECT_EQ(folder.count(), 4);  // the folder and three frames: nothing temporary is left
  const auto last = mesh::load_mesh(folder / "frames/frame_00002.obj");
  EXPECT_EQ(last.polygons, animation.mesh.polygons);
  EXPECT_EQ(last.polygon_texcoords, animation.mesh.polygon_texcoords);
  // OBJ is text: positions come back to the digits that are written.
  EXPECT_LT((last.vertices - animation.vertices_at(2)).cwiseAbs().maxCoeff(), 1e-6);
}

TEST(Sequence, FolderWithFormatEqualsPattern) {
  const ScratchFolder folder;
  SaveOptions options;
  options.format = "ply";
  seam_animation(2).save(folder / "frames", options);
  EXPECT_TRUE(std::filesystem::exists(folder / "frames/frame_00001.ply"));
}

TEST(Sequence, PatternWithoutAFolderMeansTheCurrentOne) {
  const ScratchFolder folder;
  const auto before = std::filesystem::current_path();
  std::filesystem::create_directory(folder / "here");
  std::filesystem::current_path(folder / "here");
  const auto report = seam_animation(2).save("*.ply");
  std::filesystem::current_path(before);
  EXPECT_EQ(report.num_files, 2);
  EXPECT_TRUE(std::filesystem::exists(folder / "here/frame_00001.ply"));
  EXPECT_EQ(folder.count(), 3);
}

TEST(Gltf, KeepsVertexOrderAndAppendsSeamCopies) {
  const ScratchFolder folder;
  const auto animation = seam_animation(4);
  const auto report = animation.save(folder / "a.gltf");
  EXPECT_EQ(report.num_files, 3);  // the sound beside
  EXPECT_TRUE(std::filesystem::exists(folder / "a.speech.wav"));
  const auto root = nlohmann::json::parse(core::read_text(folder / "a.gltf"));
  const auto& primitive = root["meshes"][0]["primitives"][0];
  const auto& position = root["accessors"][primitive["attributes"]["POSITION"].get<int>()];
  EXPECT_EQ(position["count"], 8);  // 6 vertices, two of them doubled on the seam
  const std::string binary = core::read_text(folder / "a.bin");
  EXPECT_EQ(binary.size(), root["buffers"][0]["byteLength"].get<size_t>());
  const auto& view = root["bufferViews"][position["bufferView"].get<int>()];
  const auto* points =
      reinterpret_cast<const float*>(binary.data() + view["byteOffset"].get<size_t>());
  for (int v = 0; v < 6; ++v) {
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(points[3 * v + k], static_cast<float>(animation.mesh.vertices(v, k)));
    }
  }
  EXPECT_EQ(primitive["targets"].size(), report.num_morph_targets);
  EXPECT_LE(report.morph_error_mm, 0.1);
}

TEST(Gltf, FaceThatNeverMovesHasNoTargets) {
  const ScratchFolder folder;
  auto animation = seam_animation(4);
  animation.displacements.zero_();
  EXPECT_EQ(animation.save(folder / "still.glb").num_morph_targets, 0);
}

TEST(Save, ExtensionsHaveNoCase) {
  const ScratchFolder folder;
  const auto animation = seam_animation(2);
  EXPECT_EQ(animation.save(folder / "FACE.GLB").format, "glb");
  EXPECT_EQ(core::read_text(folder / "FACE.GLB").substr(0, 4), "glTF");
  EXPECT_EQ(animation.save(folder / "FACE.NPZ").format, "npz");
  EXPECT_EQ(folder.count(), 3);  // the sound, no stray face.bin
  EXPECT_EQ(animation.save(folder / "FACE.GLTF").num_files, 3);
  EXPECT_EQ(load_npz(folder / "FACE.NPZ").num_frames(), 2);
  EXPECT_EQ(mesh::load_mesh(folder / "FACE.GLB").num_faces(),
            mesh::load_mesh(folder / "FACE.GLTF").num_faces());
}

TEST(Save, RefusesWhatItCannotWriteAndLeavesNothing) {
  const ScratchFolder folder;
  const auto animation = seam_animation(2);
  EXPECT_THROW(animation.save(folder / "a.abc"), std::invalid_argument);
  EXPECT_THROW(animation.save(folder / "frames"), std::invalid_argument);
  EXPECT_THROW(animation.save(folder / "a.obj"), std::invalid_argument);
  EXPECT_THROW(animation.save("/proc/nowhere/a.npz"), std::runtime_error);
  EXPECT_THROW(animation.save("/proc/nowhere/*.obj"), std::runtime_error);
  auto sparse = animation;
  sparse.displacements = animation.displacements.to_sparse();
  EXPECT_THROW(sparse.save(folder / "a.npz"), std::invalid_argument);
  EXPECT_EQ(folder.count(), 0);
}

TEST(Animation, CheckNamesWhatDoesNotFit) {
  auto animation = seam_animation(2);
  animation.displacements = at::zeros({2, 5, 3});
  EXPECT_THROW(animation.check(), std::invalid_argument);
  animation = seam_animation(2);
  animation.fps = 0;
  EXPECT_THROW(animation.check(), std::invalid_argument);
  animation = seam_animation(2);
  animation.metadata_json = "[1]";
  EXPECT_THROW(animation.check(), std::invalid_argument);
  EXPECT_THROW(seam_animation(2).vertices_at(2), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::animation
