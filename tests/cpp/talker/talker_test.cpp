#include "freetalk/talker/talker.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "freetalk/core/file.h"
#include "freetalk/core/module_io.h"
#include "freetalk/speech/pretrained.h"

namespace freetalk::talker {
namespace {

namespace fs = std::filesystem;

/// A bumpy oval with a nose, metres.
mesh::Mesh face_mesh(double unit) {
  constexpr int kN = 21;
  Eigen::MatrixXd vertices(kN * kN, 3);
  std::vector<std::vector<int>> polygons;
  for (int i = 0; i < kN; ++i) {
    for (int j = 0; j < kN; ++j) {
      const double x = 0.15 * (double(j) / (kN - 1) - 0.5), y = 0.19 * (double(i) / (kN - 1) - 0.5);
      const double nose = 0.03 * std::exp(-(x * x + (y + 0.005) * (y + 0.005)) / 2e-4);
      const double brow = 0.008 * std::exp(-(y - 0.05) * (y - 0.05) / 1e-4);
      const double chin = 0.012 * std::exp(-(x * x + (y + 0.07) * (y + 0.07)) / 4e-4);
      vertices.row(i * kN + j) << unit * x, unit * y,
          unit * (0.02 - 9 * x * x - 2.5 * y * y + nose + brow + chin);
      if (i + 1 < kN && j + 1 < kN) {
        const int a = i * kN + j;
        polygons.push_back({a, a + 1, a + kN + 1, a + kN});
      }
    }
  }
  return mesh::make_mesh(vertices, polygons, Eigen::MatrixXd(0, 2), {}, "oval");
}

audio::Audio hum(double seconds, double amplitude = 0.3) {
  audio::Audio audio;
  audio.samples.resize(static_cast<size_t>(seconds * 16000));
  for (size_t i = 0; i < audio.samples.size(); ++i) {
    const double t = static_cast<double>(i) / 16000;
    audio.samples[i] =
        static_cast<float>(amplitude * std::sin(900 * t) * (0.6 + 0.4 * std::sin(20 * t)));
  }
  return audio;
}

/// Writes small random weights once for all tests of this program.
class TalkerTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    torch::manual_seed(11);
    dir_ = fs::temp_directory_path() / ("freetalk_talker_test_" + std::to_string(::getpid()));
    fs::create_directories(dir_);
    speech::SpeechEncoderOptions heard = speech::hubert_tiny();
    heard.num_hidden_layers = 1;
    heard.hidden_size = 32;
    heard.num_attention_heads = 2;
    heard.intermediate_size = 32;
    heard.conv_dim = std::vector<int64_t>(heard.conv_dim.size(), 16);
    heard.num_conv_pos_embeddings = 8;
    heard.num_conv_pos_embedding_groups = 4;
    speech::save_speech_encoder(speech::SpeechEncoder(heard), dir_ / "speech");
    ats::AtsOptions ats;
    ats.d_model = 32;
    ats.num_layers = 1;
    ats.num_heads = 2;
    ats.ff_dim = 32;
    ats.audio_dim = 32;
    ats.max_frames = 60;
    ats::Ats denoiser(ats);
    denoiser->set_motion_statistics(at::zeros({204}), at::full({204}, 2e-3));
    core::save_model(dir_ / "ats", "freetalk-ats", core::options_to_json(ats), *denoiser);
    stm::StmOptions stm;
    stm.encoder_width = stm.decoder_width = stm.feature_dim = 16;
    stm.encoder_blocks = stm.decoder_blocks = 1;
    stm.gcn_hidden = stm.index_code_dim = stm.attention_dim = 16;
    stm.k_eig = 16;
    stm::Stm decoder(stm);
    {
      const torch::NoGradGuard no_grad;  // the last layer starts at zero: nothing would move
      for (auto& item : decoder->named_parameters()) {
        if (item.key().find("decoder.last_lin") == 0) item.value().normal_(0, 0.1);
      }
    }
    core::save_model(dir_ / "stm", "freetalk-stm", core::options_to_json(stm), *decoder);
    const auto mesh = face_mesh(1.0);
    const auto samples = geometry::sample_surface(mesh.vertices, mesh.faces, 1500);
    Eigen::MatrixXd landmarks(68, 3);
    for (int i = 0; i < 68; ++i) {
      const double angle = 2 * M_PI * i / 68;
      landmarks.row(i) << 0.04 * std::cos(angle), 0.05 * std::sin(angle), 0.01;
    }
    core::save_safetensors(dir_ / "template.safetensors", {{"points", tensor(samples.points)},
                                                           {"normals", tensor(samples.normals)},
                                                           {"landmarks68", tensor(landmarks)}});
    core::write_file_atomic(
        dir_ / "talker.json",
        std::string(R"({"format":"freetalk-talker","version":1,"generate":{"num_steps":4}})"));
  }
  static void TearDownTestSuite() { fs::remove_all(dir_); }

  static at::Tensor tensor(const Eigen::MatrixXd& matrix) {
    const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows =
        matrix.cast<float>();
    return at::from_blob(const_cast<float*>(rows.data()), {rows.rows(), rows.cols()}).clone();
  }

  static TalkerOptions options() {
    TalkerOptions result;
    result.cache_dir = (dir_ / "cache").string();
    result.unit = "m";
    result.up = "+y";
    result.forward = "+z";
    return result;
  }

  static fs::path dir_;
};
fs::path TalkerTest::dir_;

TEST_F(TalkerTest, GivesOneFramePerPeriodOfTheRequestedRate) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  for (const double fps : {30.0, 25.0, 60.0, 0.1}) {
    auto wanted = options();
    wanted.fps = fps;
    const auto animation = talker.animate(hum(1.2), mesh, wanted);
    EXPECT_EQ(animation.num_frames(), std::max<int64_t>(1, std::llround(1.2 * fps)));
    EXPECT_EQ(animation.fps, fps);
    EXPECT_TRUE(animation.displacements.isfinite().all().item<bool>());
    EXPECT_GT(animation.displacements.abs().max().item<double>(), 1e-6);
    EXPECT_EQ(animation.mesh.vertices, mesh.vertices);
    EXPECT_EQ(animation.mesh.polygons, mesh.polygons);
    EXPECT_NO_THROW(animation.check());
  }
}

TEST_F(TalkerTest, SameSeedSameBitsOtherSeedOtherMotion) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  const auto first = talker.animate(hum(1.0), mesh, wanted);
  const auto again = talker.animate(hum(1.0), mesh, wanted);
  EXPECT_TRUE(at::equal(first.displacements, again.displacements));
  EXPECT_EQ(first.metadata_json, again.metadata_json);
  wanted.seed = 1;
  EXPECT_FALSE(
      at::equal(first.displacements, talker.animate(hum(1.0), mesh, wanted).displacements));
}

TEST_F(TalkerTest, ChunksOfFramesGiveTheSame) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  const auto whole = talker.animate(hum(2.0), mesh, wanted);
  wanted.memory_mb = 1;
  const auto pieces = talker.animate(hum(2.0), mesh, wanted);
  // Matrix products of other sizes round differently.
  EXPECT_TRUE(at::allclose(whole.displacements, pieces.displacements, 1e-4, 1e-7));
}

TEST_F(TalkerTest, MeshUnitComesBack) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  auto wanted = options();
  const auto metres = talker.animate(hum(0.5), face_mesh(1.0), wanted);
  wanted.unit = "cm";
  const auto centimetres = talker.animate(hum(0.5), face_mesh(100.0), wanted);
  EXPECT_EQ(centimetres.frame.metres_per_unit, 0.01);
  const double scale = metres.displacements.abs().max().item<double>();
  // The alignment of either mesh is refined on its own: equal up to its convergence.
  EXPECT_LT((centimetres.displacements / 100 - metres.displacements).abs().max().item<double>(),
            0.05 * scale);
}

TEST_F(TalkerTest, SilenceGivesARestingFaceAndANotice) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  Report report;
  const auto animation = talker.animate(hum(1.0, 0.0), face_mesh(1.0), options(), {}, &report);
  EXPECT_EQ(animation.num_frames(), 30);
  ASSERT_EQ(report.notices.size(), 1u);
  EXPECT_NE(report.notices[0].find("silent"), std::string::npos);
}

TEST_F(TalkerTest, BlinksUnlessAskedNotTo) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  for (const double loudness : {0.0, 0.3}) {
    auto wanted = options();
    const auto with = talker.animate(hum(4.0, loudness), mesh, wanted).displacements;
    wanted.blinks = false;
    Report report;
    const auto without =
        talker.animate(hum(4.0, loudness), mesh, wanted, {}, &report).displacements;
    for (const auto& notice : report.notices) EXPECT_EQ(notice.find("blinks"), std::string::npos);
    const auto differs = (with != without).any(2).any(1);
    EXPECT_FALSE(differs.slice(0, 0, 15).any().item<bool>());
    if (loudness == 0) {
      EXPECT_TRUE(differs.any().item<bool>());
    }
    EXPECT_LT(differs.sum().item<int64_t>(), 30);
  }
}

TEST_F(TalkerTest, ReportsStagesInOrder) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  std::vector<std::string> seen;
  double last = 0;
  Report report;
  talker.animate(
      hum(0.5), face_mesh(1.0), options(),
      [&](const std::string& stage, double fraction) {
        if (seen.empty() || seen.back() != stage) {
          seen.push_back(stage);
          last = 0;
        }
        EXPECT_GE(fraction, last);
        EXPECT_LE(fraction, 1.0);
        last = fraction;
      },
      &report);
  EXPECT_EQ(seen, (std::vector<std::string>{"align", "operators", "speech", "motion", "surface"}));
  EXPECT_EQ(report.timings.size(), 5u);
  EXPECT_FALSE(report.alignment.summary.empty());
  EXPECT_FALSE(report.parts.empty());
}

TEST_F(TalkerTest, ProgressMayStopIt) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto stop = [](const std::string& stage, double) {
    if (stage == "motion") throw std::domain_error("stop");
  };
  EXPECT_THROW(talker.animate(hum(0.5), face_mesh(1.0), options(), stop), std::domain_error);
}

TEST_F(TalkerTest, BadInputIsOneSentence) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  const auto rejected = [&](auto change) {
    auto wanted = options();
    change(wanted);
    EXPECT_THROW(talker.animate(hum(0.2), mesh, wanted), std::invalid_argument);
  };
  rejected([](TalkerOptions& o) { o.intensity = 0.5; });
  rejected([](TalkerOptions& o) { o.intensity = 3.5; });
  rejected([](TalkerOptions& o) { o.intensity = NAN; });
  rejected([](TalkerOptions& o) { o.fps = 0; });
  rejected([](TalkerOptions& o) { o.fps = 241; });
  rejected([](TalkerOptions& o) { o.seed = -1; });
  rejected([](TalkerOptions& o) { o.unit = "furlong"; });
  rejected([](TalkerOptions& o) { o.sampler = "euler"; });
  rejected([](TalkerOptions& o) { o.precision = "float8"; });
  rejected([](TalkerOptions& o) {
    o.sampler = "dpmpp";
    o.eta = 0.5;
  });
  rejected([](TalkerOptions& o) { o.num_steps = 1001; });
  rejected([](TalkerOptions& o) { o.emotion = "0=neutral;happy"; });
  rejected([](TalkerOptions& o) { o.emotion = "0=neutral;1=happy@4"; });
  auto wanted = options();
  wanted.emotion = "hungry";
  try {
    talker.animate(hum(0.2), mesh, wanted);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("surprise"), std::string::npos);
  }
  EXPECT_THROW(talker.animate(audio::Audio{}, mesh, options()), std::invalid_argument);
}

TEST_F(TalkerTest, AcceptsAliasesAndMixtures) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  wanted.emotion = "fear";
  const auto alias = talker.animate(hum(0.3), mesh, wanted);
  wanted.emotion = "afraid:2";
  EXPECT_TRUE(at::equal(talker.animate(hum(0.3), mesh, wanted).displacements, alias.displacements));
  wanted.emotion = "happy:0.7,sad:0.3";
  EXPECT_FALSE(
      at::equal(talker.animate(hum(0.3), mesh, wanted).displacements, alias.displacements));
}

TEST_F(TalkerTest, EmotionKeysBeginAsTheFirstAndEndAsTheLast) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  const auto animate = [&](const char* emotion) {
    auto wanted = options();
    wanted.emotion = emotion;
    return talker.animate(hum(0.5), mesh, wanted).displacements;
  };
  // Two equal keys are one constant emotion, up to the rounding of other sums.
  EXPECT_TRUE(at::allclose(animate("0=happy@3;0.2=happy@3"), animate("happy@3"), 1e-3, 1e-7));
  // Both keys lie outside the speech: it feels only the one that holds there.
  EXPECT_TRUE(at::allclose(animate("8=sad@1;9=happy@3"), animate("sad@1"), 1e-3, 1e-7));
  EXPECT_FALSE(at::allclose(animate("0=sad@1;0.4=happy@3"), animate("sad@1"), 1e-3, 1e-7));
  // Neutral has one intensity.
  EXPECT_TRUE(at::equal(animate("neutral@3"), animate("neutral@1")));
}

TEST_F(TalkerTest, SeveralSeedsAtOnce) {
  auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  wanted.sampler = "dpmpp";
  const auto all = talker.animate_many(hum(0.5), mesh, {4, 5}, wanted);
  ASSERT_EQ(all.size(), 2u);
  for (size_t k = 0; k < 2; ++k) {
    wanted.seed = 4 + static_cast<int64_t>(k);
    const auto alone = talker.animate(hum(0.5), mesh, wanted);
    // Matrix products of other sizes round differently.
    EXPECT_TRUE(at::allclose(all[k].displacements, alone.displacements, 1e-3, 1e-7));
    EXPECT_EQ(all[k].metadata_json, alone.metadata_json);
  }
  EXPECT_FALSE(at::allclose(all[0].displacements, all[1].displacements, 1e-3, 1e-7));
  EXPECT_THROW(talker.animate_many(hum(0.5), mesh, {}, wanted), std::invalid_argument);
  EXPECT_THROW(talker.animate_many(hum(0.5), mesh, {-1}, wanted), std::invalid_argument);
}

TEST_F(TalkerTest, BrokenWeightsNameTheFile) {
  EXPECT_THROW(Talker::from_pretrained("/nowhere"), std::runtime_error);
  const auto copy = dir_.string() + "_broken";
  fs::copy(dir_, copy, fs::copy_options::recursive);
  core::write_file_atomic(fs::path(copy) / "talker.json", std::string(R"({"format":"other"})"));
  try {
    Talker::from_pretrained(copy, c10::kCPU);
    ADD_FAILURE();
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("talker.json"), std::string::npos);
  }
  fs::remove_all(copy);
}

}  // namespace
}  // namespace freetalk::talker
