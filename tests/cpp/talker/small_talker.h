// A talker of a few thousand random parameters, a face and a sound, for the tests of this room.
#pragma once

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "core/file.h"
#include "freetalk/core/module_io.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/speech/pretrained.h"
#include "freetalk/talker/models.h"
#include "freetalk/talker/talker.h"

namespace freetalk::talker {

namespace fs = std::filesystem;

/// A bumpy oval with a nose, metres.
inline mesh::Mesh face_mesh(double unit, double nose_m = 0.03) {
  constexpr int kN = 21;
  Eigen::MatrixXd vertices(kN * kN, 3);
  std::vector<std::vector<int>> polygons;
  for (int i = 0; i < kN; ++i) {
    for (int j = 0; j < kN; ++j) {
      const double x = 0.15 * (double(j) / (kN - 1) - 0.5), y = 0.19 * (double(i) / (kN - 1) - 0.5);
      const double nose = nose_m * std::exp(-(x * x + (y + 0.005) * (y + 0.005)) / 2e-4);
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

/// Options of a denoiser of a few thousand parameters, for features of 32 channels.
template <class Options>
Options small_denoiser() {
  Options options;
  options.audio_dim = options.d_model = options.ff_dim = 32;
  options.num_layers = 1;
  options.num_heads = 2;
  return options;
}

inline audio::Audio hum(double seconds, double amplitude = 0.3) {
  audio::Audio audio;
  audio.samples.resize(static_cast<size_t>(seconds * 16000));
  for (size_t i = 0; i < audio.samples.size(); ++i) {
    const double t = static_cast<double>(i) / 16000;
    audio.samples[i] =
        static_cast<float>(amplitude * std::sin(900 * t) * (0.6 + 0.4 * std::sin(20 * t)));
  }
  return audio;
}

/// Writes small random weights once for each suite of tests.
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
    auto ats = small_denoiser<ats::AtsOptions>();
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

  inline static fs::path dir_;
};

}  // namespace freetalk::talker
