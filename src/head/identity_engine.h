// The identity field of one identity, evaluated where its local networks matter.
#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "freetalk/head/identity_field.h"
#include "nn/field_inference.h"

namespace freetalk::head {

class IdentityEngine {
 public:
  /// @param anchors (K - 1, 3).
  IdentityEngine(const IdentityFieldImpl& field, const at::Tensor& anchors, bool bfloat16);

  /// The codes of all members, folded. @param codes (K, C) of IdentityFieldImpl::member_codes.
  std::vector<nn::FoldedCode> fold(const at::Tensor& codes) const;
  /// @param points (N, 3 + hyper_dim) float32. @param fade as the field does beyond its anchors.
  /// @returns (N,).
  at::Tensor run(const at::Tensor& points, const std::vector<nn::FoldedCode>& codes,
                 bool fade) const;

 private:
  struct Member {
    int64_t network;
    float origin[3];
    float mirror;  // of x
  };
  struct Row {
    int32_t point;
    float weight;
  };
  void run_chunk(const float* points, int64_t count, const std::vector<nn::FoldedCode>& codes,
                 bool fade, float* result) const;
  /// The rows of each member, and what their weights add up to.
  void gather(const float* point, int32_t index, bool fade,
              std::vector<std::vector<Row>>& rows) const;

  IdentityOptions options_;
  std::vector<Member> members_;
  std::vector<nn::PackedFieldMlp> networks_;
};

}  // namespace freetalk::head
