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

/// Landmarks of one lip, outer and inner, and the inner-lip pair whose gap each goes with.
struct Lip {
  std::vector<int64_t> inner, landmarks, pair;
};

const Lip& upper_lip() {
  static const Lip lip{{61, 62, 63}, {49, 50, 51, 52, 53, 61, 62, 63}, {0, 0, 1, 2, 2, 0, 1, 2}};
  return lip;
}

const Lip& lower_lip() {
  static const Lip lip{{67, 66, 65}, {59, 58, 57, 56, 55, 67, 66, 65}, {0, 0, 1, 2, 2, 0, 1, 2}};
  return lip;
}

}  // namespace

at::Tensor articulate(const at::Tensor& motion, double gain) {
  FREETALK_CHECK(
      motion.dim() >= 2 && motion.size(-2) == core::kNumLandmarks && motion.size(-1) == 3,
      "articulate: expected motion (..., ", core::kNumLandmarks, ", 3), found ", motion.sizes());
  FREETALK_CHECK(gain > 0, "articulation must be positive, found ", gain);
  if (gain == 1) return motion;
  const auto indices = [&](const std::vector<int64_t>& list) {
    return at::tensor(list, at::TensorOptions(motion.device()).dtype(at::kLong));
  };
  at::Tensor result = motion.clone();
  result.narrow(-2, 0, kJawEnd).mul_(gain);
  result.narrow(-2, kLips, core::kNumLandmarks - kLips).mul_(gain);
  const at::Tensor height = motion.select(-1, 1);
  const at::Tensor gap = height.index_select(-1, indices(upper_lip().inner)) -
                         height.index_select(-1, indices(lower_lip().inner));
  const at::Tensor added = (1 - gain) * gap.clamp_max(kClosedM);  // to gain * gap
  at::Tensor moved = result.select(-1, 1);
  for (const auto& [lip, share] : {std::pair{&upper_lip(), 0.5}, std::pair{&lower_lip(), -0.5}}) {
    moved.index_add_(-1, indices(lip->landmarks),
                     share * added.index_select(-1, indices(lip->pair)));
  }
  return result;
}

}  // namespace freetalk::ats
