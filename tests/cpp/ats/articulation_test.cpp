// How far the mouth goes, at the same closures.
#include "freetalk/ats/articulation.h"

#include <gtest/gtest.h>
#include <torch/torch.h>

#include <tuple>
#include <vector>

#include "freetalk/core/random.h"

namespace freetalk::ats {
namespace {

/// (T, 3) m, between the inner lips.
at::Tensor gaps(const at::Tensor& motion) {
  const at::Tensor height = motion.select(-1, 1);
  return height.index_select(-1, at::tensor({61, 62, 63}, at::kLong)) -
         height.index_select(-1, at::tensor({67, 66, 65}));
}

/// Lips pressed by up to 1 mm to open by 2 cm, everything else at random.
at::Tensor mouths() {
  at::Tensor motion = 2e-3 * torch::randn({400, 68, 3}, core::make_generator(1));
  const at::Tensor wanted = torch::linspace(-1e-3, 2e-2, 400).unsqueeze(1).expand({400, 3});
  const at::Tensor lower = motion.select(-1, 1).index_select(-1, at::tensor({67, 66, 65}));
  motion.select(-1, 1).index_copy_(-1, at::tensor({61, 62, 63}, at::kLong), lower + wanted);
  return motion;
}

TEST(Articulation, KeepsClosuresAndScalesOpenings) {
  const at::Tensor motion = mouths(), before = gaps(motion);
  for (const double gain : {0.5, 0.8, 1.2, 1.5}) {
    const at::Tensor after = gaps(articulate(motion, gain));
    const at::Tensor expected = torch::where(before <= 1e-3, before, 1e-3 + gain * (before - 1e-3));
    EXPECT_LT((after - expected).abs().max().item<double>(), 1e-7) << gain;  // float32 rounding
    EXPECT_GE(after.diff(1, 0).min().item<double>(), 0.0) << gain;           // the order of gaps
    EXPECT_TRUE((after >= torch::minimum(before, at::full({}, 1e-3)) - 1e-7).all().item<bool>());
  }
}

TEST(Articulation, MovesLipsAndJawAlone) {
  const at::Tensor motion = mouths(), wide = articulate(motion, 1.5);
  EXPECT_TRUE(at::equal(wide.narrow(1, 17, 31), motion.narrow(1, 17, 31)));  // brows, nose, eyes
  EXPECT_TRUE(at::allclose(wide.narrow(1, 0, 17), 1.5 * motion.narrow(1, 0, 17)));
  const at::Tensor corners = at::tensor({48, 54, 60, 64});
  EXPECT_TRUE(at::allclose(wide.index_select(1, corners), 1.5 * motion.index_select(1, corners)));
  // The outline of a lip goes with its inner edge: what the gap differs by is shared by both lips.
  const at::Tensor added = gaps(wide) - 1.5 * gaps(motion);
  const at::Tensor moved = wide.select(-1, 1) - 1.5 * motion.select(-1, 1);
  for (const auto& [upper, lower, pair] : std::vector<std::tuple<int, int, int>>{{49, 59, 0},
                                                                                 {50, 58, 0},
                                                                                 {51, 57, 1},
                                                                                 {62, 66, 1},
                                                                                 {52, 56, 2},
                                                                                 {53, 55, 2},
                                                                                 {63, 65, 2}}) {
    const at::Tensor half = 0.5 * added.select(1, pair);
    EXPECT_TRUE(at::allclose(moved.select(1, upper), half, 1e-4, 1e-7));
    EXPECT_TRUE(at::allclose(moved.select(1, lower), -half, 1e-4, 1e-7));
  }
}

TEST(Articulation, OfOneIsTheMotionItself) {
  const at::Tensor motion = mouths();
  EXPECT_TRUE(articulate(motion, 1.0).is_same(motion));
  EXPECT_TRUE(at::equal(articulate(motion.unsqueeze(0), 1.3)[0], articulate(motion, 1.3)));
  EXPECT_THROW(articulate(motion, 0), std::invalid_argument);
  EXPECT_THROW(articulate(motion.flatten(1), 1.5), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::ats
