#include "freetalk/talker/live.h"

#include <random>

#include "freetalk/rig/face_rig.h"
#include "small_talker.h"

namespace freetalk::talker {
namespace {

class LiveTest : public TalkerTest {
 protected:
  static Face face() {
    return Talker::from_pretrained(dir_, c10::kCPU).prepare(face_mesh(1.0), options());
  }
  /// Pushes in pieces of random length below `most`, then finishes.
  static std::vector<LiveFrame> run(Live& live, const std::vector<float>& samples, size_t most) {
    std::mt19937 random(static_cast<unsigned>(most));
    std::vector<LiveFrame> frames;
    const auto take = [&](std::vector<LiveFrame> made) {
      frames.insert(frames.end(), made.begin(), made.end());
    };
    for (size_t at = 0; at < samples.size();) {
      const size_t count = std::min<size_t>(random() % most, samples.size() - at);
      take(live.push({samples.begin() + static_cast<int64_t>(at),
                      samples.begin() + static_cast<int64_t>(at + count)}));
      at += count;
    }
    take(live.finish());
    return frames;
  }
  static at::Tensor motion(const std::vector<LiveFrame>& frames) {
    std::vector<at::Tensor> landmarks;
    for (const LiveFrame& frame : frames) landmarks.push_back(frame.landmarks);
    return at::stack(landmarks);
  }
};

TEST_F(LiveTest, GivesTheSameBitsHoweverTheSamplesAreCut) {
  const auto samples = hum(3.3).samples;
  Live live = face().live({});
  const auto whole = live.push(samples);
  auto rest = live.finish();
  auto all = whole;
  all.insert(all.end(), rest.begin(), rest.end());
  ASSERT_EQ(all.size(), 99u);
  for (size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].index, static_cast<int64_t>(i));
    EXPECT_EQ(all[i].time_s, static_cast<double>(i) / 30.0);
  }
  EXPECT_GT(motion(all).abs().max().item<float>(), 1e-5);
  for (const size_t most : {700, 5000, 40000}) {
    // The stream starts afresh after finish(): the same object serves again.
    EXPECT_TRUE(at::equal(motion(run(live, samples, most)), motion(all))) << most;
  }
}

TEST_F(LiveTest, FramesCarryWeightsOfTheFacesRigWhereTheWeightsHoldPoses) {
  const auto samples = hum(1.5).samples;
  Live without = face().live({});
  EXPECT_FALSE(run(without, samples, 5000).front().weights.defined());
  EXPECT_THROW(face().rig(), std::runtime_error);

  torch::manual_seed(5);
  TalkerModels models = Talker::from_pretrained(dir_, c10::kCPU).models();
  models.rig = {
      {"jawOpen", "browInnerUp"}, 2e-3 * at::randn({2, 68, 3}), 2e-3 * at::randn({30, 68, 3})};
  const Face rigged = Talker(models).prepare(face_mesh(1.0), options());
  std::vector<at::Tensor> weights;
  for (const size_t most : {700, 40000}) {
    Live live = rigged.live({});
    std::vector<at::Tensor> rows;
    for (const LiveFrame& frame : run(live, samples, most)) {
      rows.push_back(frame.weights);
      EXPECT_TRUE(live.decode(frame).isfinite().all().item<bool>());
    }
    weights.push_back(at::stack(rows));
  }
  EXPECT_EQ(weights[0].size(1), rigged.rig().targets().size(0));
  EXPECT_EQ(&rigged.rig(), &rigged.rig());  // made once
  EXPECT_GE(weights[0].min().item<float>(), 0.0F);
  EXPECT_LE(weights[0].max().item<float>(), 1.0F);
  EXPECT_TRUE(at::equal(weights[0], weights[1]));  // however the samples are cut

  LiveOptions exact;
  exact.rig = false;
  Live decoded = rigged.live(exact);
  EXPECT_FALSE(run(decoded, samples, 5000).front().weights.defined());
}

TEST_F(LiveTest, TheHeadMovesAsThatOfTheClip) {
  const audio::Audio audio = hum(2.5);
  AnimateOptions clip;
  clip.head_motion = true;
  clip.seed = 5;
  LiveOptions wanted;
  wanted.head_motion = true;
  wanted.seed = 5;
  for (const size_t most : {700, 40000}) {
    Live live = face().live(wanted);
    std::vector<at::Tensor> poses;
    for (const LiveFrame& frame : run(live, audio.samples, most)) {
      poses.push_back(live.head(frame));
    }
    EXPECT_TRUE(at::equal(at::stack(poses), face().animate(audio, clip).head));
  }
  Live still = face().live({});
  EXPECT_FALSE(still.head(run(still, audio.samples, 5000).front()).defined());
}

TEST_F(LiveTest, AFrameComesWithinTheLatency) {
  Live live = face().live({});
  EXPECT_NEAR(live.latency_s(), 0.42, 1e-9);
  const auto samples = hum(2.5).samples;
  constexpr size_t kStep = 160;
  int64_t next = 0;
  for (size_t at = 0; at + kStep <= samples.size(); at += kStep) {
    const auto frames = live.push({samples.begin() + static_cast<int64_t>(at),
                                   samples.begin() + static_cast<int64_t>(at + kStep)});
    if (!frames.empty()) next = frames.back().index + 1;
    const double heard_s = static_cast<double>(at + kStep) / 16000;
    EXPECT_LE(heard_s - static_cast<double>(next) / live.fps(), live.latency_s() + 1e-9);
  }
}

TEST_F(LiveTest, HoldsNoMoreAfterTenTimesTheContext) {
  LiveOptions wanted;
  wanted.context_s = 0.5;
  wanted.hop_s = 0.2;
  Live live = face().live(wanted);
  const auto samples = hum(2.0).samples;  // ten hops
  live.push(samples);
  live.push(samples);
  const int64_t held = live.num_held();
  EXPECT_GT(held, 0);
  for (int i = 0; i < 8; ++i) {
    live.push(samples);
    EXPECT_LE(live.num_held(), held + 3 * 204);  // noise is drawn four frames at a time
  }
}

TEST_F(LiveTest, AnEmotionChangesWhatFollowsAndNothingBefore) {
  const auto samples = hum(3.0).samples;
  const std::vector<float> half(samples.begin(), samples.begin() + 24000),
      rest(samples.begin() + 24000, samples.end());
  const auto play = [&](bool change) {
    LiveOptions wanted;
    wanted.emotion = "sad";
    wanted.blinks = false;
    Live live = face().live(wanted);
    auto frames = live.push(half);
    if (change) live.set_emotion("happy", 3.0);
    for (auto& more : {live.push(rest), live.finish()}) {
      frames.insert(frames.end(), more.begin(), more.end());
    }
    return motion(frames);
  };
  const at::Tensor same = play(false), changed = play(true);
  EXPECT_TRUE(at::equal(same.narrow(0, 0, 30), changed.narrow(0, 0, 30)));  // shown before
  EXPECT_FALSE(at::allclose(same.narrow(0, 66, 24), changed.narrow(0, 66, 24), 1e-3, 1e-7));
}

TEST_F(LiveTest, DecodesTheVerticesOfTheMesh) {
  const auto on = face();
  Live live(on);
  live.push(hum(1.0).samples);
  const auto frames = live.push(hum(1.0).samples);
  ASSERT_FALSE(frames.empty());
  const at::Tensor vertices = live.decode(frames[0]);
  const at::Tensor rest = tensor(on.mesh().vertices);
  ASSERT_EQ(vertices.sizes(), rest.sizes());
  const double moved = (vertices - rest).abs().max().item<double>();
  EXPECT_GT(moved, 1e-6);
  EXPECT_LT(moved, 0.1);
}

TEST_F(LiveTest, BlinksUnlessAskedNotTo) {
  const auto play = [&](bool blinks) {
    LiveOptions wanted;
    wanted.blinks = blinks;
    Live live = face().live(wanted);
    return motion(run(live, hum(6.0).samples, 8000));
  };
  const auto differs = (play(true) != play(false)).any(2).any(1);
  EXPECT_TRUE(differs.any().item<bool>());
  EXPECT_LT(differs.sum().item<int64_t>(), 60);  // few frames, and none fed back to the model
}

TEST_F(LiveTest, BadOptionsAreOneSentence) {
  const auto on = face();
  const auto rejected = [&](auto change) {
    LiveOptions wanted;
    change(wanted);
    EXPECT_THROW(on.live(wanted), std::invalid_argument);
  };
  rejected([](LiveOptions& o) { o.emotion = "hungry"; });
  rejected([](LiveOptions& o) { o.intensity = 4; });
  rejected([](LiveOptions& o) { o.hop_s = 0; });
  rejected([](LiveOptions& o) { o.lookahead_s = 0.001; });
  rejected([](LiveOptions& o) { o.window_frames = 61; });  // the model has 60
  rejected([](LiveOptions& o) { o.window_frames = 6; });
  rejected([](LiveOptions& o) { o.sampler = "ddpm"; });
  rejected([](LiveOptions& o) { o.num_steps = 0; });
  EXPECT_TRUE(on.live({}).finish().empty());
  EXPECT_THROW(on.live({}).decode(LiveFrame{}), std::runtime_error);
}

TEST_F(LiveTest, ATalkerStreamsOnTheFacesOfItsWeights) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto on = talker.prepare(face_mesh(1.0), options());
  const auto samples = hum(1.0).samples;
  Live by_talker = Talker(talker).live(on, {}), by_face = on.live({});
  EXPECT_TRUE(
      at::equal(motion(run(by_talker, samples, 5000)), motion(run(by_face, samples, 5000))));
  EXPECT_THROW(talker.live(face(), {}), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::talker
