// Heads move a little, rigidly, about the neck, and more where the voice is loud.
#include "freetalk/talker/head_motion.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <algorithm>
#include <random>
#include <vector>

namespace freetalk::talker {
namespace {

/// Noise that is loud for two seconds and quiet for one, over and over.
audio::Audio phrases(double seconds, double amplitude = 0.3) {
  audio::Audio audio;
  std::mt19937 random(1);
  for (int64_t i = 0; i < static_cast<int64_t>(seconds * 16000); ++i) {
    const bool loud = i % 48000 < 32000;
    const double noise = static_cast<double>(random()) / 4294967296.0 - 0.5;
    audio.samples.push_back(static_cast<float>(loud ? amplitude * noise : 0.0));
  }
  return audio;
}

/// (T, 3) degrees: pitch, yaw, roll.
at::Tensor angles(const at::Tensor& head) {
  const auto of = [&](int row, int column) { return head.select(1, row).select(1, column); };
  return torch::rad2deg(at::stack(
      {at::atan2(of(2, 1), of(2, 2)), at::asin(-of(2, 0)), at::atan2(of(1, 0), of(0, 0))}, 1));
}

TEST(HeadMotion, IsRigidAboutTheNeckAndStartsAtRest) {
  const at::Tensor head = head_motion(phrases(10), 300, 30.0, 4);
  ASSERT_EQ(head.sizes(), (at::IntArrayRef{300, 4, 4}));
  const at::Tensor turn = head.slice(1, 0, 3).slice(2, 0, 3);
  const at::Tensor product = turn.matmul(turn.transpose(1, 2));
  EXPECT_LT((product - at::eye(3, at::kDouble)).abs().max().item<double>(), 1e-12);
  EXPECT_GT(at::linalg_det(turn).min().item<double>(), 0);
  EXPECT_TRUE(
      at::equal(head.select(1, 3), at::tensor({0., 0., 0., 1.}, at::kDouble).expand({300, 4})));
  const at::Tensor neck = at::tensor({0., -0.092, -0.032, 1.}, at::kDouble);
  EXPECT_LT((head.matmul(neck) - neck).abs().max().item<double>(), 1e-12);
  EXPECT_LT(angles(head)[0].abs().max().item<double>(), 0.5);
}

TEST(HeadMotion, AStreamGivesTheSameBitsAndHoldsLittle) {
  const audio::Audio audio = phrases(12);
  const at::Tensor whole = head_motion(audio, 360, 30.0, 4);
  HeadMotionStream stream(16000, 30.0, 4);
  std::vector<at::Tensor> parts;
  const auto total = static_cast<int64_t>(audio.samples.size());
  int64_t shown = 0;
  for (int64_t first = 0; first < total; first += 1920) {
    const int64_t count = std::min<int64_t>(1920, total - first);
    stream.hear(audio.samples.data() + first, count);
    const int64_t safe = (first + count) * 30 / 16000 - 4;  // heard a frame beyond
    if (safe <= shown) continue;
    parts.push_back(stream.next(safe - shown));
    shown = safe;
    EXPECT_LT(stream.num_held(), 8 * 16000 / 30);
  }
  parts.push_back(stream.next(360 - shown));
  EXPECT_TRUE(at::equal(at::cat(parts), whole));
}

TEST(HeadMotion, IsAsLargeAsThatOfTrackedHeads) {
  for (const double fps : {25.0, 60.0}) {  // the motion's size is not the frame rate's
    const at::Tensor turned =
        angles(head_motion(phrases(600), static_cast<int64_t>(600 * fps), fps, 9));
    const at::Tensor spread = turned.std(0);
    // Standard deviations within clips of the tracked talker: 0.77, 0.52 and 0.28 degrees; a long
    // recording drifts further than clips of 3 s.
    const std::vector<double> tracked = {0.77, 0.52, 0.28};
    for (int k = 0; k < 3; ++k) {
      EXPECT_GT(spread[k].item<double>(), 0.8 * tracked[static_cast<size_t>(k)]) << fps << " " << k;
      EXPECT_LT(spread[k].item<double>(), 1.4 * tracked[static_cast<size_t>(k)]) << fps << " " << k;
    }
    EXPECT_LT(turned.abs().max().item<double>(), 8.0);
  }
}

TEST(HeadMotion, FollowsTheVoiceAndTheSeed) {
  const auto moved = [](double amplitude, uint64_t seed) {
    return head_motion(phrases(120, amplitude), 3600, 30.0, seed);
  };
  EXPECT_TRUE(at::equal(moved(0.3, 1), moved(0.3, 1)));
  EXPECT_FALSE(at::equal(moved(0.3, 1), moved(0.3, 2)));
  const at::Tensor loud = angles(moved(0.3, 1)), silent = angles(moved(0.0, 1));
  const auto speed = [](const at::Tensor& turned) {
    return 30 * turned.diff(1, 0).abs().mean(0)[0].item<double>();
  };
  // Pitch of the tracked talker: 4.0 degrees a second where he is loud, 1.2 where he is silent.
  EXPECT_GT(speed(loud), 2 * speed(silent));
  EXPECT_NEAR(speed(silent), 1.2, 0.4);
  // The head rises with the voice: pitch is negative.
  EXPECT_LT((loud - silent).mean(0)[0].item<double>(), -0.5);
  EXPECT_THROW(head_motion(phrases(1), 0, 30.0, 1), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::talker
