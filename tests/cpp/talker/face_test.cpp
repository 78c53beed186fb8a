#include "freetalk/talker/face.h"

#include <cstdlib>
#include <thread>

#include "freetalk/core/log.h"
#include "small_talker.h"

namespace freetalk::talker {
namespace {

class FaceTest : public TalkerTest {};

TEST_F(FaceTest, GivesTheBitsOfTheOneCall) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  auto wanted = options();
  const auto face = talker.prepare(face_mesh(1.0), wanted);
  for (const int64_t seed : {0, 3}) {
    wanted.seed = seed;
    const auto prepared = face.animate(hum(0.7), wanted);
    const auto whole = talker.animate(hum(0.7), face_mesh(1.0), wanted);
    EXPECT_TRUE(at::equal(prepared.displacements, whole.displacements));
    EXPECT_EQ(prepared.metadata_json, whole.metadata_json);
  }
}

TEST_F(FaceTest, OutlivesItsTalker) {
  const auto face = Talker::from_pretrained(dir_, c10::kCPU).prepare(face_mesh(1.0), options());
  EXPECT_EQ(face.animate(hum(0.3)).num_frames(), 9);
}

TEST_F(FaceTest, FillsTheCallersBuffer) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  const auto face = talker.prepare(mesh, options());
  const auto own = face.animate(hum(0.5));
  const int64_t frames = Face::num_frames(hum(0.5), 30.0);
  auto out = at::full({frames, mesh.num_vertices(), 3}, NAN);
  const auto into = face.animate(hum(0.5), {}, {}, nullptr, out);
  EXPECT_EQ(into.displacements.data_ptr(), out.data_ptr());
  EXPECT_TRUE(at::equal(out, own.displacements));
  const auto wrong = [&](const at::Tensor& other) {
    EXPECT_THROW(face.animate(hum(0.5), {}, {}, nullptr, other), std::invalid_argument);
  };
  wrong(at::empty({frames + 1, mesh.num_vertices(), 3}));
  wrong(at::empty({frames, mesh.num_vertices(), 3}, at::kDouble));
  wrong(at::empty({frames, 3, mesh.num_vertices()}).transpose(1, 2));
  wrong(out.to_sparse());
}

TEST_F(FaceTest, KeysAsValuesAreTheKeysOfTheLanguage) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto face = talker.prepare(face_mesh(1.0), options());
  AnimateOptions wanted;
  wanted.emotion = "0.1=neutral; 0.4=happy:0.7,surprise:0.3@2.5";
  const auto text = face.animate(hum(0.6), wanted).displacements;
  wanted.emotion = emotion_text(
      {{0.1, {{"neutral", 1.0}}, {}}, {0.4, {{"happy", 0.7}, {"surprise", 0.3}}, 2.5}});
  EXPECT_TRUE(at::equal(face.animate(hum(0.6), wanted).displacements, text));
  EXPECT_THROW(emotion_text({}), std::invalid_argument);
  EXPECT_THROW(emotion_text({{0.0, {{"happy@3", 1.0}}, {}}}), std::invalid_argument);
}

TEST_F(FaceTest, IntensitiesAreTheWeights) {
  auto models = Talker::from_pretrained(dir_, c10::kCPU).models();
  auto own = models.ats->options();
  own.num_intensities = 5;
  models.ats = ats::Ats(own);
  const Talker talker(models);
  EXPECT_EQ(talker.max_intensity(), 5);
  const auto face = talker.prepare(face_mesh(1.0), options());
  AnimateOptions wanted;
  wanted.emotion = "happy";
  wanted.intensity = 5;
  EXPECT_NO_THROW(face.animate(hum(0.2), wanted));
  wanted.intensity = 5.1;
  EXPECT_THROW(face.animate(hum(0.2), wanted), std::invalid_argument);
  wanted.intensity = 3;  // the middle, which is the default
  const auto middle = face.animate(hum(0.2), wanted).displacements;
  wanted.intensity.reset();
  EXPECT_TRUE(at::equal(face.animate(hum(0.2), wanted).displacements, middle));
}

TEST_F(FaceTest, WritesNoFileUnlessTold) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto home = dir_ / "home";
  ::setenv("FREETALK_CACHE", home.c_str(), 1);
  ::setenv("TMPDIR", "/nowhere", 1);  // a file there would be told of
  FaceOptions wanted;
  wanted.unit = "m";
  std::vector<std::string> told;
  core::set_log_sink([&](core::LogLevel, const std::string& text) { told.push_back(text); });
  talker.prepare(face_mesh(1.0), wanted).animate(hum(0.2));
  EXPECT_FALSE(fs::exists(home));
  wanted.cache_dir = "auto";
  talker.prepare(face_mesh(1.0), wanted);
  EXPECT_TRUE(fs::exists(home / "operators"));
  core::set_log_sink({});
  ::unsetenv("FREETALK_CACHE");
  ::unsetenv("TMPDIR");
  EXPECT_TRUE(told.empty());
}

TEST_F(FaceTest, TellsOfACacheThatCannotBeWritten) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto file = dir_ / "file";
  core::write_file_atomic(file, std::string("no folder"));
  FaceOptions wanted;
  wanted.cache_dir = (file / "cache").string();
  std::vector<std::string> told;
  core::set_log_sink([&](core::LogLevel level, const std::string& text) {
    if (level == core::LogLevel::kWarning) told.push_back(text);
  });
  EXPECT_EQ(talker.prepare(face_mesh(1.0), wanted).animate(hum(0.2)).num_frames(), 6);
  core::set_log_sink({});
  ASSERT_EQ(told.size(), 1u);
  EXPECT_NE(told[0].find("not kept"), std::string::npos);
}

TEST_F(FaceTest, TenThreadsWithTenMeshesGetTheBitsOfOne) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  constexpr size_t kThreads = 10;
  const auto animate = [&](size_t i) {
    auto wanted = options();
    wanted.cache_dir.reset();
    wanted.seed = static_cast<int64_t>(i);
    wanted.emotion = i % 2 == 0 ? "happy" : "0=sad;0.2=angry";
    wanted.precision = i % 3 == 0 ? "bfloat16" : "float32";
    const auto mesh = face_mesh(1.0, 0.025 + 0.001 * static_cast<double>(i));
    return talker.animate(hum(0.4 + 0.05 * static_cast<double>(i)), mesh, wanted).displacements;
  };
  std::vector<at::Tensor> alone, together(kThreads);
  for (size_t i = 0; i < kThreads; ++i) alone.push_back(animate(i));
  std::vector<std::thread> threads;
  for (size_t i = 0; i < kThreads; ++i) {
    threads.emplace_back([&, i] { together[i] = animate(i); });
  }
  for (std::thread& thread : threads) thread.join();
  for (size_t i = 0; i < kThreads; ++i) EXPECT_TRUE(at::equal(alone[i], together[i])) << i;
}

TEST_F(FaceTest, ThreadsShareOneFace) {
  const auto face = Talker::from_pretrained(dir_, c10::kCPU).prepare(face_mesh(1.0), options());
  const auto animate = [&](int64_t seed) {
    AnimateOptions wanted;
    wanted.seed = seed;
    return face.animate(hum(0.6), wanted).displacements;
  };
  std::vector<at::Tensor> together(4);
  std::vector<std::thread> threads;
  for (int64_t i = 0; i < 4; ++i) {
    threads.emplace_back([&, i] { together[static_cast<size_t>(i)] = animate(i); });
  }
  for (std::thread& thread : threads) thread.join();
  for (int64_t i = 0; i < 4; ++i) {
    EXPECT_TRUE(at::equal(animate(i), together[static_cast<size_t>(i)])) << i;
  }
}

}  // namespace
}  // namespace freetalk::talker
