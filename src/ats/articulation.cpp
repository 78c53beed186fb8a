#include "freetalk/ats/articulation.h"

#include <ATen/ATen.h>

#include <utility>
#include <vector>

#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"

namespace freetalk::ats {
namespace {

constexpr double kClosedM = 0.001;           // c
constexpr int64_t kJawEnd = 17, kLips = 48;  // iBUG: the jaw is [0, 17), the lips [48, 68)

}  // namespace

at::Tensor articulate(const at::Tensor& motion, double gain) {
  FREETALK_CHECK(
      motion.dim() >= 2 && motion.size(-2) == core::kNumLandmarks && motion.size(-1) == 3,
      "articulate: expected motion (..., ", core::kNumLandmarks, ", 3), found ", motion.sizes());
  FREETALK_CHECK(gain > 0, "articulation must be positive, found ", gain);
  if (gain == 1) return motion;
  const auto indices = [&](const auto& list, auto&& of) {
    std::vector<int64_t> values;
    for (const auto& each : list) values.push_back(of(each));
    return at::tensor(values, at::TensorOptions(motion.device()).dtype(at::kLong));
  };
  at::Tensor result = motion.clone();
  result.narrow(-2, 0, kJawEnd).mul_(gain);
  result.narrow(-2, kLips, core::kNumLandmarks - kLips).mul_(gain);
  const at::Tensor height = motion.select(-1, 1);
  const auto inner = [&](size_t lip) {
    return indices(core::kInnerLips, [lip](const auto& pair) { return pair[lip]; });
  };
  const at::Tensor gap = height.index_select(-1, inner(0)) - height.index_select(-1, inner(1));
  const at::Tensor added = (1 - gain) * gap.clamp_max(kClosedM);  // to gain * gap
  at::Tensor moved = result.select(-1, 1);
  for (const auto& [lip, share] :
       {std::pair{&core::kUpperLip, 0.5}, std::pair{&core::kLowerLip, -0.5}}) {
    const auto landmark = indices(*lip, [](const auto& each) { return each.landmark; });
    const auto pair = indices(*lip, [](const auto& each) { return each.pair; });
    moved.index_add_(-1, landmark, share * added.index_select(-1, pair));
  }
  return result;
}

}  // namespace freetalk::ats
