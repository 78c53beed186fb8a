#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "kernels/block_kernels.h"
#include "kernels/fused_kernels.h"
#include "kernels/isa.h"
#include "kernels/sparse_rows.h"

namespace freetalk::kernels {
namespace {

std::vector<Isa> levels() {
  std::vector<Isa> result;
  for (int level = 0; level <= static_cast<int>(best_isa()); ++level) {
    result.push_back(static_cast<Isa>(level));
  }
  return result;
}

template <class T>
std::vector<T> uniform(size_t count, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<double> draw(-1.0, 1.0);
  std::vector<T> result(count);
  for (T& value : result) value = static_cast<T>(draw(generator));
  return result;
}

TEST(IsaDeathTest, EnvironmentNamesTheLevel) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");  // a process of its own reads the variable anew
  for (const Isa level : levels()) {
    EXPECT_EXIT(
        {
          setenv("FREETALK_ISA", isa_name(level).c_str(), 1);
          std::exit(isa() == level ? 0 : 1);
        },
        testing::ExitedWithCode(0), "");
  }
}

TEST(IsaDeathTest, UnknownLevelIsAnErrorThatNamesTheKnownOnes) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        setenv("FREETALK_ISA", "sse9", 1);
        try {
          isa();
        } catch (const std::invalid_argument& error) {
          std::cerr << error.what();
          std::exit(0);
        }
        std::exit(1);
      },
      testing::ExitedWithCode(0), "sse9.*baseline");
}

TEST(Isa, ScopesNest) {
  const Isa before = isa();
  {
    const IsaScope outer(Isa::baseline);
    {
      const IsaScope inner(best_isa());
      EXPECT_EQ(isa(), best_isa());
    }
    EXPECT_EQ(isa(), Isa::baseline);
  }
  EXPECT_EQ(isa(), before);
}

template <class Value, class Index>
void expect_products_of_rows(double tolerance) {
  constexpr int64_t kRows = 23, kColumns = 31;
  std::mt19937 generator(7);
  std::vector<Index> first{0}, column;
  for (int64_t row = 0; row < kRows; ++row) {  // every third row is empty
    for (int64_t c = row % 3; row % 3 > 0 && c < kColumns; c += 1 + generator() % 9) {
      column.push_back(static_cast<Index>(c));
    }
    first.push_back(static_cast<Index>(column.size()));
  }
  const auto value = uniform<Value>(column.size(), 1);
  for (const int64_t channels : {1, 3, 16, 67, 192}) {
    const auto x = uniform<Value>(static_cast<size_t>(kColumns * channels), 2);
    for (const Isa level : levels()) {
      const IsaScope scope(level);
      std::vector<Value> y(static_cast<size_t>((kRows - 2) * channels), Value(9));
      multiply_rows<Value, Index>({first.data(), column.data(), value.data()}, 2, kRows, x.data(),
                                  channels, y.data());
      for (int64_t row = 2; row < kRows; ++row) {
        for (int64_t c = 0; c < channels; ++c) {
          double expected = 0.0;
          for (Index e = first[row]; e < first[row + 1]; ++e) {
            expected += double(value[e]) * double(x[column[e] * channels + c]);
          }
          ASSERT_NEAR(y[(row - 2) * channels + c], expected, tolerance)
              << isa_name(level) << ", " << channels << " channels, row " << row;
        }
      }
    }
  }
}

// Tolerances: the rounding of about ten sums of products below one.
TEST(SparseRows, AreThePlainSumsAtEveryLevel) {
  expect_products_of_rows<float, int32_t>(2e-6);
  expect_products_of_rows<float, int64_t>(2e-6);
  expect_products_of_rows<double, int32_t>(4e-15);
  expect_products_of_rows<double, int64_t>(4e-15);
}

TEST(BlockKernels, GramAndProductAreThePlainSumsAtEveryLevel) {
  constexpr int64_t kRows = 77;
  TallBlock a(kRows), b(kRows);
  const auto left = uniform<double>(kRows * 8, 3), right = uniform<double>(kRows * 8, 4);
  std::copy(left.begin(), left.end(), a.data());
  std::copy(right.begin(), right.end(), b.data());
  for (const Isa level : levels()) {
    const IsaScope scope(level);
    alignas(64) double gram[64] = {};
    block_kernels().add_gram(a.data(), b.data(), kRows, gram);
    TallBlock target(kRows);
    std::copy(right.begin(), right.end(), target.data());
    block_kernels().subtract_product(a.data(), gram, kRows, target.data());
    for (int i = 0; i < 8; ++i) {
      for (int j = 0; j < 8; ++j) {
        double sum = 0.0;
        for (int64_t r = 0; r < kRows; ++r) sum += left[r * 8 + i] * right[r * 8 + j];
        ASSERT_NEAR(gram[i * 8 + j], sum, 1e-13) << isa_name(level);
      }
    }
    for (int64_t r = 0; r < kRows; ++r) {
      for (int j = 0; j < 8; ++j) {
        double rest = right[r * 8 + j];
        for (int i = 0; i < 8; ++i) rest -= left[r * 8 + i] * gram[i * 8 + j];
        ASSERT_NEAR(target.row(r)[j], rest, 1e-12) << isa_name(level);
      }
    }
  }
}

TEST(FusedKernels, SoftplusIsItsFormulaAtEveryLevel) {
  constexpr double kBeta = 100.0;
  std::vector<float> x(512);
  for (size_t i = 0; i < x.size(); ++i) x[i] = (static_cast<float>(i) - 256.0F) / 300.0F;
  for (const Isa level : levels()) {
    const IsaScope scope(level);
    std::vector<float> y = x;
    float_kernels().softplus(y.data(), static_cast<int64_t>(y.size()), static_cast<float>(kBeta));
    for (size_t i = 0; i < x.size(); ++i) {  // the polynomial's 3e-7, over beta, and rounding
      const double expected = std::log1p(std::exp(-std::abs(kBeta * x[i]))) / kBeta +
                              std::max(0.0, static_cast<double>(x[i]));
      EXPECT_NEAR(y[i], expected, 1e-7) << isa_name(level) << " at " << x[i];
    }
  }
}

TEST(FusedKernels, ProductsAndSoftmaxAreThePlainSumsAtEveryLevel) {
  constexpr int64_t kRows = 31, kInner = 40, kColumns = 64;
  const auto a = uniform<float>(kRows * kInner, 5), b = uniform<float>(kInner * kColumns, 6);
  const auto bias = uniform<float>(kColumns, 7);
  for (const Isa level : levels()) {
    const IsaScope scope(level);
    const Kernels<float>& kernels = float_kernels();
    std::vector<float> packed(b.size()), result(kRows * kColumns), shares(result.size());
    kernels.pack(b.data(), kInner, kColumns, packed.data());
    const Segment<float> segment{a.data(), kInner, packed.data(), kInner};
    Epilogue epilogue;
    epilogue.bias = bias.data();
    kernels.product(&segment, 1, kRows, kColumns, epilogue, result.data(), nullptr, kColumns);
    constexpr int64_t kCount = 61;
    kernels.softmax(result.data(), kRows, kColumns, kCount, shares.data());
    for (int64_t row = 0; row < kRows; ++row) {
      double total = 0.0;
      for (int64_t c = 0; c < kColumns; ++c) {
        double sum = bias[static_cast<size_t>(c)];
        for (int64_t k = 0; k < kInner; ++k) sum += a[row * kInner + k] * b[k * kColumns + c];
        // 40 products below one in float32.
        ASSERT_NEAR(result[row * kColumns + c], sum, 1e-5) << isa_name(level);
        if (c < kCount) total += std::exp(double(result[row * kColumns + c]));
      }
      for (int64_t c = 0; c < kCount; ++c) {
        // The kernel's exponential is right to 3e-7.
        ASSERT_NEAR(shares[row * kColumns + c],
                    std::exp(double(result[row * kColumns + c])) / total, 2e-6)
            << isa_name(level);
      }
    }
  }
}

}  // namespace
}  // namespace freetalk::kernels
