#include "freetalk/talker/talker.h"

#include <nlohmann/json.hpp>

#include "small_talker.h"

namespace freetalk::talker {
namespace {

TEST_F(TalkerTest, GivesOneFramePerPeriodOfTheRequestedRate) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
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
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
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
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  const auto whole = talker.animate(hum(2.0), mesh, wanted);
  wanted.memory_mb = 1;
  const auto pieces = talker.animate(hum(2.0), mesh, wanted);
  // Matrix products of other sizes round differently.
  EXPECT_TRUE(at::allclose(whole.displacements, pieces.displacements, 1e-4, 1e-7));
}

TEST_F(TalkerTest, MeshUnitComesBack) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
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
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  Report report;
  const auto animation = talker.animate(hum(1.0, 0.0), face_mesh(1.0), options(), {}, &report);
  EXPECT_EQ(animation.num_frames(), 30);
  ASSERT_EQ(report.notices.size(), 2u);  // the test's face is one skin
  EXPECT_NE(report.notices[0].find("the lips are one closed skin"), std::string::npos);
  EXPECT_NE(report.notices[1].find("silent"), std::string::npos);
}

TEST_F(TalkerTest, BlinksUnlessAskedNotTo) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  for (const double loudness : {0.0, 0.3}) {
    auto wanted = options();
    wanted.tolerance_mm = 0;  // interpolation carries a blink's trace to other frames
    const auto with = talker.animate(hum(9.0, loudness), mesh, wanted).displacements;
    wanted.blinks = false;
    Report report;
    const auto without =
        talker.animate(hum(9.0, loudness), mesh, wanted, {}, &report).displacements;
    for (const auto& notice : report.notices) EXPECT_EQ(notice.find("blinks"), std::string::npos);
    const auto differs = (with != without).any(2).any(1);
    if (loudness == 0) {
      EXPECT_TRUE(differs.any().item<bool>());
    }
    EXPECT_LT(differs.sum().item<int64_t>(), 60);
  }
}

TEST_F(TalkerTest, AMovingHeadIsATransformBesideTheSameMotion) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(100.0);  // centimetres
  auto wanted = options();
  wanted.unit = "cm";
  const auto still = talker.animate(hum(2.0), mesh, wanted);
  EXPECT_FALSE(still.head.defined());
  wanted.head_motion = true;
  const auto moving = talker.animate(hum(2.0), mesh, wanted);
  EXPECT_TRUE(at::equal(moving.displacements, still.displacements));
  ASSERT_EQ(moving.head.sizes(), (at::IntArrayRef{60, 4, 4}));
  // Rigid: lengths between vertices stay, in the mesh's own unit.
  const Eigen::MatrixXd before = still.vertices_at(50), after = moving.vertices_at(50);
  EXPECT_NEAR((after.row(0) - after.row(400)).norm(), (before.row(0) - before.row(400)).norm(),
              1e-9);
  const double shift = (after - before).rowwise().norm().maxCoeff();
  EXPECT_GT(shift, 0.005);  // cm
  EXPECT_LT(shift, 2.0);
  EXPECT_TRUE(at::equal(talker.animate(hum(2.0), mesh, wanted).head, moving.head));
}

TEST_F(TalkerTest, ArticulationScalesTheMouthAndItsRangeIsChecked) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  const auto usual = talker.animate(hum(1.0), mesh, wanted).displacements;
  wanted.articulation = 1.5;
  const auto wide = talker.animate(hum(1.0), mesh, wanted).displacements;
  EXPECT_FALSE(at::allclose(usual, wide, 1e-2, 1e-7));
  for (const double wrong : {0.4, 1.6, std::nan("")}) {
    wanted.articulation = wrong;
    EXPECT_THROW(talker.animate(hum(1.0), mesh, wanted), std::invalid_argument);
  }
}

TEST_F(TalkerTest, ReportsStagesInOrder) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
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
  EXPECT_EQ(seen, (std::vector<std::string>{"align", "parts", "operators", "features", "speech",
                                            "motion", "surface"}));
  EXPECT_EQ(report.timings.size(), 7u);
  EXPECT_FALSE(report.alignment.summary.empty());
  EXPECT_FALSE(report.parts.empty());
}

TEST_F(TalkerTest, ProgressMayStopItInEveryStage) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  auto wanted = options();
  wanted.cache_dir.reset();
  for (const char* stage :
       {"align", "parts", "operators", "features", "speech", "motion", "surface"}) {
    const auto stop = [&](const std::string& current, double) {
      if (current == stage) throw std::domain_error("stop");
    };
    EXPECT_THROW(talker.animate(hum(0.5), face_mesh(1.0), wanted, stop), std::domain_error)
        << stage;
  }
}

TEST_F(TalkerTest, BadInputIsOneSentence) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
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
  EXPECT_THROW(Talker(talker.models(), c10::Device("cuda:99")), std::runtime_error);
}

TEST_F(TalkerTest, AcceptsAliasesAndMixtures) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  wanted.emotion = "fear";
  const auto alias = talker.animate(hum(0.3), mesh, wanted);
  wanted.emotion = "afraid:1";
  EXPECT_TRUE(at::equal(talker.animate(hum(0.3), mesh, wanted).displacements, alias.displacements));
  wanted.emotion = "happy:0.7,sad:0.3";
  EXPECT_FALSE(
      at::equal(talker.animate(hum(0.3), mesh, wanted).displacements, alias.displacements));
}

TEST_F(TalkerTest, EmotionKeysBeginAsTheFirstAndEndAsTheLast) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  const auto animate = [&](const char* emotion) {
    auto wanted = options();
    wanted.emotion = emotion;
    wanted.tolerance_mm = 0;
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

TEST_F(TalkerTest, InterpolatedFramesKeepToTheTolerance) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  wanted.blinks = false;
  wanted.tolerance_mm = 0;
  Report exact, adaptive;
  const auto every = talker.animate(hum(6.0), mesh, wanted, {}, &exact).displacements;
  wanted.tolerance_mm = 0.2;
  const auto some = talker.animate(hum(6.0), mesh, wanted, {}, &adaptive);
  EXPECT_EQ(exact.num_frames, 180);
  EXPECT_EQ(exact.decoded_frames, 180);
  EXPECT_EQ(adaptive.num_frames, 180);
  EXPECT_LE(adaptive.decoded_frames, 180);
  EXPECT_LE(adaptive.decode_error_mm, 0.2);
  EXPECT_LE((some.displacements - every).norm(2, 2).max().item<double>(), 0.2e-3);
  const auto told = nlohmann::json::parse(some.metadata_json)["decoding"];
  EXPECT_EQ(told["decoded_frames"], adaptive.decoded_frames);
}

TEST_F(TalkerTest, SeveralSeedsAtOnce) {
  const auto talker = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  auto wanted = options();
  wanted.sampler = "dpmpp";
  wanted.tolerance_mm = 0;  // which frames are decoded may turn on a rounding
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

TEST_F(TalkerTest, FaceTalkSpeaksWhereTheWeightsHoldIt) {
  const Talker without = Talker::from_pretrained(dir_, c10::kCPU);
  const auto mesh = face_mesh(1.0);
  TalkerOptions chosen = options();
  chosen.motion = "facetalk";
  try {
    without.animate(hum(0.5), mesh, chosen);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("facetalk/"), std::string::npos);
  }
  auto small = small_denoiser<facetalk::FaceTalkOptions>();
  small.code_dim = 4;
  facetalk::FaceTalk denoiser(small);
  denoiser->set_code_statistics(at::zeros({4}), at::ones({4}), at::zeros({4}),
                                at::full({4, 204}, 1e-3));
  TalkerModels models = without.models();
  models.facetalk = denoiser;
  const Talker talker(models);
  const auto by_ats = talker.animate(hum(0.5), mesh, options());
  Report report;
  chosen.emotion = "happy";
  const auto found = talker.animate(hum(0.5), mesh, chosen, {}, &report);
  EXPECT_EQ(found.num_frames(), by_ats.num_frames());
  EXPECT_FALSE(torch::equal(found.displacements, by_ats.displacements));
  ASSERT_FALSE(report.notices.empty());
  EXPECT_NE(report.notices.back().find("knows no emotions"), std::string::npos);
  chosen.motion = "voca";
  EXPECT_THROW(talker.animate(hum(0.5), mesh, chosen), std::invalid_argument);

  core::save_model(dir_ / "facetalk", "freetalk-facetalk", core::options_to_json(small), *denoiser);
  chosen.motion = "facetalk";
  const auto loaded = Talker::from_pretrained(dir_, c10::kCPU).animate(hum(0.5), mesh, chosen);
  EXPECT_TRUE(torch::allclose(loaded.displacements, found.displacements, 1e-4, 1e-6));
  // The weights' own gain and the option multiply, and that of ATS's motion has no part in it.
  models.code_motion.articulation = 1.2;
  models.generate.articulation = 2;
  chosen.articulation = 1.25;
  const auto wide = Talker(models).animate(hum(0.5), mesh, chosen);
  models.code_motion.articulation = 1.5;
  chosen.articulation = 1;
  const auto wider = Talker(models).animate(hum(0.5), mesh, chosen);
  EXPECT_TRUE(torch::allclose(wide.displacements, wider.displacements, 1e-4, 1e-6));
  EXPECT_FALSE(torch::allclose(wide.displacements, found.displacements, 1e-2, 1e-6));
  // The weights say how it is sampled, unless options do.
  models.code_motion = {};
  models.code_motion.num_steps = 1;
  chosen.num_steps.reset();
  const auto quick = Talker(models).animate(hum(0.5), mesh, chosen);
  chosen.num_steps = 1;
  EXPECT_TRUE(
      torch::equal(quick.displacements, talker.animate(hum(0.5), mesh, chosen).displacements));
  EXPECT_FALSE(torch::allclose(quick.displacements, found.displacements, 1e-2, 1e-6));
  small.audio_dim = 12;
  facetalk::FaceTalk deaf(small);
  core::save_model(dir_ / "facetalk", "freetalk-facetalk", core::options_to_json(small), *deaf);
  EXPECT_THROW(Talker::from_pretrained(dir_, c10::kCPU), std::runtime_error);
  fs::remove_all(dir_ / "facetalk");
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
