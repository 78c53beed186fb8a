// Formats read back: what was written is what comes out.
#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include <fstream>

#include "animation/morph_normals.h"
#include "core/file.h"
#include "freetalk/animation/animation.h"
#include "freetalk/mesh/appearance.h"
#include "scratch.h"

namespace freetalk::animation {
namespace {

using testing::ScratchFolder;
using testing::seam_animation;

/// Largest distance in mm of the first vertices of every frame from those of `expected`.
double distance_mm(const Animation& found, const Animation& expected) {
  const auto count = expected.mesh.num_vertices();
  double largest = 0.0;
  for (int64_t t = 0; t < expected.num_frames(); ++t) {
    const Eigen::MatrixXd vertices = expected.vertices_at(t);
    const Eigen::MatrixXd world =
        expected.frame.metres_per_unit * (vertices * expected.frame.to_y_up.transpose());
    const Eigen::MatrixXd off = found.vertices_at(t).topRows(count) - world;
    largest = std::max(largest, 1e3 * off.rowwise().norm().maxCoeff());
  }
  return largest;
}

Animation turned_animation() {
  auto animation = seam_animation(12);
  animation.frame.to_y_up << 0, 1, 0, 0, 0, 1, 1, 0, 0;
  return animation;
}

TEST(Gltf, ComesBackWithinItsError) {
  const ScratchFolder folder;
  const auto animation = turned_animation();
  for (const char* name : {"a.glb", "a.gltf", "c.glb"}) {
    SaveOptions options;
    options.compact = name[0] == 'c';
    const auto report = animation.save(folder / name, options);
    const auto found = load_gltf(folder / name);
    EXPECT_EQ(found.fps, animation.fps);
    EXPECT_EQ(found.num_frames(), animation.num_frames());
    EXPECT_LE(distance_mm(found, animation), report.morph_error_mm + 1e-4) << name;
    ASSERT_EQ(found.audio.samples.size(), animation.audio.samples.size()) << name;
    EXPECT_NEAR(found.audio.samples[1], animation.audio.samples[1], 1.0 / 32767);
    EXPECT_EQ(found.audio.sample_rate_hz, 8000);
  }
}

TEST(Gltf, GivenShapesKeepTheirNamesAndWeights) {
  const ScratchFolder folder;
  auto animation = seam_animation(9);
  BlendShapes given;
  given.names = {"jawOpen", "browDown"};
  given.targets = at::randn({2, 6, 3}, at::detail::createCPUGenerator(5)) * 0.02;
  given.weights = at::rand({9, 2}, at::detail::createCPUGenerator(6));
  const auto report = animation.save(folder / "a.glb", {}, given);
  EXPECT_GT(report.num_morph_targets, 2);
  EXPECT_LE(distance_mm(load_gltf(folder / "a.glb"), animation), report.morph_error_mm + 1e-4);
  EXPECT_NE(core::read_text(folder / "a.glb").find(R"("targetNames":["jawOpen","browDown",)"),
            std::string::npos);
  given.weights += 0.5;
  EXPECT_THROW(animation.save(folder / "a.glb", {}, given), std::invalid_argument);
}

TEST(Gltf, MotionGoesIntoTheMeshsOwnFile) {
  const ScratchFolder folder;
  auto first = seam_animation(4);
  first.save(folder / "character.glb");
  Animation second;
  second.mesh = mesh::load_mesh(folder / "character.glb");
  second.displacements =
      at::randn({5, second.mesh.num_vertices(), 3}, at::detail::createCPUGenerator(7)) * 1e-3;
  second.displacements.slice(1, 6).copy_(  // the seam's copies move with their originals
      second.displacements.index_select(1, at::tensor({1, 4})));
  const auto report = second.save(folder / "talk.glb");
  EXPECT_TRUE(report.into_source);
  const auto found = load_gltf(folder / "talk.glb");
  EXPECT_EQ(found.num_frames(), 5);
  const auto& expected = second;
  EXPECT_LE(distance_mm(found, expected), report.morph_error_mm + 1e-4);
  const std::string bytes = core::read_text(folder / "talk.glb");
  EXPECT_NE(bytes.find("\"skin\""), std::string::npos);  // its material
  core::write_file_atomic(folder / "character.glb", "gone");
  EXPECT_FALSE(second.save(folder / "b.glb").into_source);
  EXPECT_LE(distance_mm(load_gltf(folder / "b.glb"), expected), report.morph_error_mm + 1e-4);
  std::filesystem::remove(folder / "character.glb");
  EXPECT_FALSE(second.save(folder / "b.glb").into_source);
}

/// The mesh of a file with a motion of its own.
Animation motion_on(const std::filesystem::path& file, int64_t frames, uint64_t seed) {
  Animation animation;
  animation.mesh = mesh::load_mesh(file);
  const auto random = at::detail::createCPUGenerator(seed);
  animation.displacements = at::randn({frames, animation.mesh.num_vertices(), 3}, random) * 1e-3;
  animation.displacements.slice(1, 6).copy_(animation.displacements.index_select(
      1, at::tensor({1, 4})));  // the seam's copies move with their originals
  animation.head = at::eye(4, at::kDouble).repeat({frames, 1, 1});
  animation.head.select(2, 3).slice(1, 0, 3).copy_(at::rand({frames, 3}, random));
  animation.audio = {{0.5f, -0.25f}, 8000};
  return animation;
}

nlohmann::json json_of(const std::filesystem::path& glb) {
  const std::string bytes = core::read_text(glb);
  return nlohmann::json::parse(bytes.substr(20, bytes.find("BIN") - 24));
}

TEST(Gltf, ASecondMotionReplacesTheFirst) {
  const ScratchFolder folder;
  seam_animation(4).save(folder / "first.glb");
  const auto second = motion_on(folder / "first.glb", 5, 7);
  const auto report = second.save(folder / "second.glb");
  EXPECT_TRUE(report.into_source);
  const auto third = motion_on(folder / "second.glb", 3, 8);
  third.save(folder / "third.glb");
  EXPECT_LE(distance_mm(load_gltf(folder / "third.glb"), third), report.morph_error_mm + 1e-3);
  const auto json = json_of(folder / "third.glb");
  const auto& primitive = json["meshes"][0]["primitives"][0];
  const auto targets = json["meshes"][0]["extras"]["targetNames"].size();
  EXPECT_EQ(primitive["targets"].size(), targets);
  EXPECT_LE(targets, 4);  // no more than three frames and a sign need
  EXPECT_EQ(json["animations"].size(), 1);
  EXPECT_EQ(json["nodes"].size(), 2);
  EXPECT_EQ(json["extensions"]["KHR_audio_emitter"]["audio"].size(), 1);
  // The first file's motion leaves nothing behind, however often.
  motion_on(folder / "third.glb", 3, 8).save(folder / "fourth.glb");
  EXPECT_EQ(core::read_text(folder / "third.glb"), core::read_text(folder / "fourth.glb"));
  Animation still = motion_on(folder / "third.glb", 2, 9);
  still.displacements.zero_();
  still.head = at::Tensor();
  still.audio = {};
  still.save(folder / "still.glb");
  EXPECT_FALSE(json_of(folder / "still.glb").contains("animations"));
  EXPECT_FALSE(json_of(folder / "still.glb").contains("extensions"));
}

TEST(Gltf, TargetsAndAnimationsOfOthersStayWithWeightsForEveryTarget) {
  const ScratchFolder folder;
  seam_animation(4).save(folder / "ours.glb");
  std::string bytes = core::read_text(folder / "ours.glb");
  for (size_t at = 0; (at = bytes.find("\"freetalk\"", at)) != std::string::npos; ++at) {
    bytes.replace(at, 10, "\"somebody\"");
  }
  core::write_file_atomic(folder / "theirs.glb", bytes);
  const size_t own = json_of(folder / "theirs.glb")["meshes"][0]["weights"].size();
  motion_on(folder / "theirs.glb", 5, 7).save(folder / "first.glb");
  const auto second = motion_on(folder / "first.glb", 3, 8);
  const auto report = second.save(folder / "second.glb");
  EXPECT_LE(distance_mm(load_gltf(folder / "second.glb"), second), report.morph_error_mm + 1e-3);
  const auto json = json_of(folder / "second.glb");
  const size_t targets = json["meshes"][0]["primitives"][0]["targets"].size();
  EXPECT_EQ(targets, own + static_cast<size_t>(report.num_morph_targets));
  EXPECT_EQ(json["meshes"][0]["extras"]["targetNames"].size(), targets);
  ASSERT_EQ(json["animations"].size(), 2);  // ours, theirs
  EXPECT_EQ(json["extensions"]["KHR_audio_emitter"]["audio"].size(), 2);
  for (const auto& animation : json["animations"]) {
    for (const auto& channel : animation["channels"]) {
      const auto& sampler = animation["samplers"][channel["sampler"].get<size_t>()];
      const auto count = [&](const char* key) {
        return json["accessors"][sampler[key].get<size_t>()]["count"].get<size_t>();
      };
      if (channel["target"]["path"] != "weights") continue;
      EXPECT_EQ(count("output"), count("input") * targets);
    }
  }
}

TEST(Gltf, AMovingHeadComesBack) {
  const ScratchFolder folder;
  auto animation = turned_animation();
  animation.head = at::eye(4, at::kDouble).repeat({animation.num_frames(), 1, 1});
  for (int64_t t = 0; t < animation.num_frames(); ++t) {
    const double angle = 0.4 * static_cast<double>(t);  // beyond half a turn
    Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> pose(
        animation.head.data_ptr<double>() + 16 * t);
    pose.topLeftCorner<3, 3>() =
        Eigen::AngleAxisd(angle, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
    pose.topRightCorner<3, 1>() = angle * Eigen::Vector3d(0.3, -0.2, 0.1);
  }
  for (const char* name : {"a.glb", "a.gltf", "c.glb"}) {
    SaveOptions options;
    options.compact = name[0] == 'c';
    const auto report = animation.save(folder / name, options);
    const auto found = load_gltf(folder / name);
    EXPECT_TRUE(found.head.defined()) << name;
    EXPECT_LE(distance_mm(found, animation), report.morph_error_mm + 1e-3) << name;
  }
}

TEST(Gltf, MaterialsColoursAndTexturesOfAnObjAreKept) {
  const ScratchFolder folder;
  const std::string png = "\x89PNG\r\n\x1a\n picture";
  std::ofstream(folder / "skin.png", std::ios::binary) << png;
  std::ofstream(folder / "face.mtl") << "newmtl lip skin\nKd 0.5 0.25 1\nd 0.5\n"
                                     << "newmtl cheek\nmap_Kd -s 1 1 1 C:\\art\\skin.png\n";
  std::ofstream(folder / "face.obj")
      << "mtllib face.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 1 1 1\n"
      << "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl lip skin\nf 1/1 2/2 3/3\n"
      << "usemtl cheek\nf 1/1 3/3 4/4\n";
  Animation animation;
  animation.mesh = mesh::load_mesh(folder / "face.obj");
  const auto look = mesh::load_appearance(animation.mesh);
  ASSERT_EQ(look.materials.size(), 2u);
  EXPECT_EQ(look.materials[0].colour, Eigen::Vector4d(0.5, 0.25, 1.0, 0.5));
  EXPECT_EQ(look.materials[1].texture.bytes, png);
  EXPECT_EQ(look.polygon_material, (std::vector<int>{0, 1}));
  EXPECT_EQ(look.colours.row(1), Eigen::RowVector4d(0, 1, 0, 1));
  animation.displacements = at::randn({3, 4, 3}) * 0.01;
  animation.save(folder / "talk.glb");
  const std::string bytes = core::read_text(folder / "talk.glb");
  for (const char* expected : {"lip skin", "COLOR_0", "baseColorTexture", "TEXCOORD_0", "BLEND"}) {
    EXPECT_NE(bytes.find(expected), std::string::npos) << expected;
  }
  EXPECT_NE(bytes.find(png), std::string::npos);
  animation.save(folder / "talk.usda");
  EXPECT_EQ(core::read_text(folder / "talk.textures" / "skin.png"), png);
}

TEST(Appearance, ReadsNothingOutsideTheFolderOfTheMesh) {
  const ScratchFolder folder;
  std::filesystem::create_directory(folder / "in");
  std::ofstream(folder / "secret.png") << "\x89PNG secret";
  std::ofstream(folder / "in/notes.txt") << "no picture";
  std::ofstream(folder / "in/face.mtl") << "newmtl a\nmap_Kd ../secret.png\n"
                                        << "newmtl b\nmap_Kd " << (folder / "secret.png").string()
                                        << "\nnewmtl c\nmap_Kd notes.txt\n";
  std::ofstream(folder / "in/face.obj") << "mtllib face.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
                                        << "usemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\nusemtl c\n"
                                        << "f 1 2 3\n";
  const auto look = mesh::load_appearance(mesh::load_mesh(folder / "in/face.obj"));
  ASSERT_EQ(look.materials.size(), 3u);
  for (const auto& material : look.materials) EXPECT_TRUE(material.texture.bytes.empty());
}

TEST(Pc2, HoldsTheVerticesOfEveryFrame) {
  const ScratchFolder folder;
  const auto animation = seam_animation(7);
  animation.save(folder / "a.pc2");
  const std::string bytes = core::read_text(folder / "a.pc2");
  EXPECT_EQ(bytes.size(), 32u + 7 * 6 * 12);
  EXPECT_EQ(bytes.substr(0, 11), "POINTCACHE2");
  const auto found = load_pc2(folder / "a.pc2", animation.mesh, 25);
  EXPECT_LT((found.displacements - animation.displacements).abs().max().item<float>(), 1e-6);
  core::write_file_atomic(folder / "b.pc2", bytes.substr(0, 100));
  EXPECT_THROW(load_pc2(folder / "b.pc2", animation.mesh), std::runtime_error);
  mesh::Mesh large = animation.mesh;
  large.vertices *= 100;  // the same in centimetres
  EXPECT_THROW(load_pc2(folder / "a.pc2", large), std::runtime_error);
}

TEST(Sequence, ComesBackFromItsFolder) {
  const ScratchFolder folder;
  const auto animation = seam_animation(4);
  std::vector<double> shares;
  animation.save(folder / "frames/*.obj", {}, {}, [&](double share) { shares.push_back(share); });
  EXPECT_EQ(shares.size(), 4u);
  const auto found = load_sequence(folder / "frames", 25);
  EXPECT_LT((found.vertices_at(3) - animation.vertices_at(3)).cwiseAbs().maxCoeff(), 1e-6);
}

TEST(Save, WhatProgressThrowsLeavesNothing) {
  const ScratchFolder folder;
  for (const char* name : {"a.pc2", "a.glb", "frames/*.ply"}) {
    const auto stop = [](double) { throw std::runtime_error("enough"); };
    EXPECT_THROW(seam_animation(3).save(folder / name, {}, {}, stop), std::runtime_error) << name;
  }
  EXPECT_EQ(folder.count(), 0);
}

TEST(Npz, KeepsTheLandmarks) {
  const ScratchFolder folder;
  auto animation = seam_animation(3);
  animation.landmarks = at::randn({3, 68, 3});
  animation.save(folder / "a.npz");
  EXPECT_TRUE(at::equal(load_npz(folder / "a.npz").landmarks, animation.landmarks));
  animation.landmarks = at::zeros({2, 68, 3});
  EXPECT_THROW(animation.save(folder / "b.npz"), std::invalid_argument);
}

TEST(MorphNormals, AreTheDerivativeOfTheNormals) {
  auto animation = seam_animation(1);
  animation.mesh.vertices.col(2) << 0.1, 0.3, 0.0, 0.2, -0.1, 0.15;
  const MorphNormals normals(animation.mesh);
  const auto target = animation.displacements[0];
  const auto derivative = normals.derivative(target);
  constexpr double kStep = 1e-3;
  auto moved = animation.mesh;
  for (int v = 0; v < 6; ++v) {
    for (int c = 0; c < 3; ++c) moved.vertices(v, c) += kStep * target[v][c].item<float>();
  }
  const auto measured = (MorphNormals(moved).rest() - normals.rest()) / kStep;
  EXPECT_LT((measured - derivative).abs().max().item<float>(), 2e-3);
}

}  // namespace
}  // namespace freetalk::animation
