#include <gtest/gtest.h>
#include <torch/nn/modules/linear.h>

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <set>

#include "../decimal_comma.h"
#include "core/file.h"
#include "core/number.h"
#include "core/scratch.h"
#include "freetalk/core/error.h"
#include "freetalk/core/log.h"
#include "freetalk/core/module_io.h"
#include "freetalk/core/options.h"
#include "freetalk/core/random.h"
#include "freetalk/core/safetensors.h"
#include "freetalk/core/torch_error.h"

namespace freetalk::core {
namespace {

struct SampleOptions {
  int64_t width = 8;
  double rate = 0.5;
  bool flag = false;
  std::string name = "a";
  std::vector<int64_t> sizes = {1, 2};
  std::optional<double> limit;
  std::optional<std::string> folder = "here";
  template <class V>
  void fields(V& v) {
    v("width", width);
    v("rate", rate);
    v("flag", flag);
    v("name", name);
    v("sizes", sizes);
    v("limit", limit);
    v("folder", folder);
  }
  void check() const { FREETALK_CHECK(width > 0, "width must be positive, found ", width); }
};

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

std::filesystem::path temporary_path(const std::string& name) {
  return std::filesystem::path(::testing::TempDir()) / ("freetalk_core_" + name);
}

TEST(Options, RoundTripThroughJson) {
  SampleOptions options;
  options.width = 3;
  options.sizes = {4, 5, 6};
  SampleOptions copy;
  options_from_json(copy, options_to_json(options), "test");
  EXPECT_EQ(options_to_json(copy), options_to_json(options));
  EXPECT_EQ(copy.sizes, (std::vector<int64_t>{4, 5, 6}));
}

TEST(Options, NothingIsNull) {
  SampleOptions options;
  EXPECT_NE(options_to_json(options).find(R"("limit":null,"folder":"here")"), std::string::npos);
  options_from_json(options, R"({"limit": 2, "folder": null})", "test");
  EXPECT_EQ(options.limit, 2.0);
  EXPECT_EQ(options.folder, std::nullopt);
  options_from_json(options, R"({"limit": null})", "test");
  EXPECT_EQ(options.limit, std::nullopt);
  EXPECT_NE(error_of([&] {
              options_from_json(options, R"({"limit": "x"})", "f");
            }).find("a number or null"),
            std::string::npos);
  EXPECT_NE(
      error_of([&] { options_from_json(options, R"({"width": null})", "f"); }).find("an integer"),
      std::string::npos);
}

TEST(Log, GoesToTheSink) {
  std::vector<std::string> told;
  set_log_sink([&](LogLevel level, const std::string& text) {
    if (level >= LogLevel::kInfo) told.push_back(text);
  });
  log(LogLevel::kDebug, "detail");
  log(LogLevel::kWarning, "careful");
  set_log_sink({});
  ::testing::internal::CaptureStderr();
  log(LogLevel::kInfo, "not told");
  log(LogLevel::kError, "told by default");
  EXPECT_EQ(told, std::vector<std::string>{"careful"});
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "freetalk: told by default\n");
}

TEST(Options, UnknownKeyNamesTheNearest) {
  SampleOptions options;
  const std::string message =
      error_of([&] { options_from_json(options, R"({"widht": 3})", "file.yaml"); });
  EXPECT_NE(message.find("file.yaml"), std::string::npos);
  EXPECT_NE(message.find("did you mean 'width'"), std::string::npos);
}

TEST(Options, WrongTypeAndFailedCheckThrow) {
  SampleOptions options;
  EXPECT_NE(
      error_of([&] { options_from_json(options, R"({"width": "x"})", "f"); }).find("an integer"),
      std::string::npos);
  EXPECT_NE(error_of([&] { options_from_json(options, R"({"width": 0})", "f"); }).find("positive"),
            std::string::npos);
}

TEST(Safetensors, RoundTripKeepsDtypeShapeAndMetadata) {
  const auto path = temporary_path("roundtrip.safetensors");
  const TensorMap tensors = {{"a", torch::arange(6, torch::kFloat).view({2, 3})},
                             {"b", torch::arange(5, torch::kLong)},
                             {"c", torch::ones({3}, torch::kHalf)},
                             {"empty", torch::empty({0, 4})}};
  save_safetensors(path, tensors, {{"k", "v"}});
  const SafetensorsFile file(path);
  EXPECT_EQ(file.metadata().at("k"), "v");
  for (const auto& [name, tensor] : tensors) {
    EXPECT_EQ(file.tensor(name).scalar_type(), tensor.scalar_type());
    EXPECT_TRUE(torch::equal(file.tensor(name), tensor)) << name;
  }
}

TEST(Safetensors, BrokenFilesAreNamed) {
  const auto path = temporary_path("broken.safetensors");
  save_safetensors(path, {{"a", torch::ones({64})}});
  std::filesystem::resize_file(path, 100);
  EXPECT_NE(error_of([&] { load_safetensors(path); }).find("broken.safetensors"),
            std::string::npos);
  write_file_atomic(path, std::string("not safetensors at all"));
  EXPECT_NE(error_of([&] { load_safetensors(path); }).find("not a safetensors file"),
            std::string::npos);
  EXPECT_NE(error_of([&] { load_safetensors(temporary_path("absent")); }).find("no such file"),
            std::string::npos);
}

TEST(ModuleIo, EveryMisfitIsListed) {
  torch::nn::Linear linear(2, 3);
  const std::string message = error_of([&] {
    load_state(*linear, {{"weight", torch::ones({3, 5})}, {"extra", torch::ones({1})}}, "w");
  });
  EXPECT_NE(message.find("missing: bias"), std::string::npos);
  EXPECT_NE(message.find("shape of weight"), std::string::npos);
  EXPECT_NE(message.find("unexpected: extra"), std::string::npos);
}

TEST(ModuleIo, HalfPrecisionWeightsAreConverted) {
  torch::nn::Linear linear(2, 2);
  load_state(*linear,
             {{"weight", torch::full({2, 2}, 0.5, torch::kHalf)}, {"bias", torch::zeros({2})}},
             "w");
  EXPECT_EQ(linear->weight.scalar_type(), torch::kFloat);
  EXPECT_TRUE(torch::allclose(linear->weight, torch::full({2, 2}, 0.5)));
}

TEST(File, FailedWriteLeavesTheOldFile) {
  const auto path = temporary_path("atomic.txt");
  write_file_atomic(path, std::string("old"));
  EXPECT_THROW(write_file_atomic(path,
                                 [](std::ostream& stream) {
                                   stream << "half";
                                   throw std::runtime_error("stop");
                                 }),
               std::runtime_error);
  EXPECT_EQ(read_text(path), "old");
}

TEST(File, TemporaryNamesDifferBetweenProcessesOfTheSameNumber) {
  // Containers that share a folder repeat process numbers and counters: only chance tells apart.
  const auto path = temporary_path("names.txt");
  std::set<std::filesystem::path> names;
  for (int i = 0; i < 100; ++i) {
    names.insert(unused_neighbour(path));
    EXPECT_EQ(names.rbegin()->parent_path(), path.parent_path());
  }
  EXPECT_EQ(names.size(), 100);
  std::filesystem::path temporary;
  write_file_atomic(path, [&](std::ostream&) {
    for (const auto& entry : std::filesystem::directory_iterator(path.parent_path())) {
      const auto name = entry.path().filename().string();
      if (name.starts_with("freetalk_core_names.txt.tmp-")) temporary = entry.path();
    }
  });
  EXPECT_FALSE(temporary.empty());
  EXPECT_EQ(temporary.string().find(join("-", getpid(), "-")), std::string::npos);
  EXPECT_FALSE(std::filesystem::exists(temporary));
}

TEST(File, TheExtensionHasNoCase) {
  EXPECT_EQ(lower_extension("a/FACE.GLB"), "glb");
  EXPECT_EQ(lower_extension("a.b/face"), "");
}

TEST(Number, ReadsTheSameInEveryLocaleAndBeyondTheRangeOfADouble) {
  const freetalk::testing::DecimalComma comma;
  if (!comma.is_set()) GTEST_SKIP() << "no locale with a decimal comma can be had";
  const auto parsed = [](const std::string& text) {
    double value = 0;
    const auto [end, error] = parse_number(text.data(), text.data() + text.size(), value);
    EXPECT_EQ(error, std::errc()) << text;
    EXPECT_EQ(end, text.data() + text.size()) << text;
    return value;
  };
  EXPECT_EQ(parsed("0.75"), 0.75);
  EXPECT_EQ(parsed("1.5e-400"), 0.0);
  EXPECT_EQ(parsed("1.5e400"), std::numeric_limits<double>::infinity());
  EXPECT_EQ(parsed("-1.5e400"), -std::numeric_limits<double>::infinity());
  const std::string word = "x";
  double value = 0;
  EXPECT_EQ(parse_number(word.data(), word.data() + 1, value).ec, std::errc::invalid_argument);
}

TEST(TorchError, IsARuntimeErrorOfOneSentenceAndOthersPass) {
  const auto add = [] { return at::ones({2}) + at::ones({3}); };
  EXPECT_THROW(add(), c10::Error);
  try {
    with_plain_errors("adding", add);
    FAIL();
  } catch (const std::runtime_error& error) {
    const std::string message = error.what();
    EXPECT_TRUE(message.starts_with("adding: The size of tensor a (2)")) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
  }
  EXPECT_THROW(with_plain_errors("asking", [] { FREETALK_CHECK(false, "no"); }),
               std::invalid_argument);
  EXPECT_EQ(with_plain_errors("counting", [] { return 3; }), 3);
}

TEST(ModuleIo, SaysWhichVersionItCannotRead) {
  const auto folder = temporary_path("version");
  torch::nn::Linear linear(2, 2);
  save_model(folder, "test-format", "{}", *linear);
  EXPECT_EQ(read_model_options(folder, "test-format"), "{}");
  std::string config = read_text(folder / "config.json");
  config.replace(config.find("\"version\": 1"), 12, "\"version\": 7");
  write_file_atomic(folder / "config.json", config);
  EXPECT_NE(error_of([&] { read_model_options(folder, "test-format"); }).find("version 7"),
            std::string::npos);
}

TEST(ModuleIo, ASaveThatStoppedBetweenItsFilesReadsAsTheNewModel) {
  const auto folder = temporary_path("stopped");
  torch::nn::Linear small(2, 2), large(3, 3);
  save_model(folder, "test-format", R"({"width":2})", *small);
  const std::string older = read_text(folder / "config.json");
  save_model(folder, "test-format", R"({"width":3})", *large);
  write_file_atomic(folder / "config.json", older);
  EXPECT_EQ(read_model_options(folder, "test-format"), R"({"width":3})");
}

/// Memory of this process that lies in pages right now, bytes.
int64_t resident_bytes() {
  int64_t total = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> total >> resident;
  return resident * 4096;
}

TEST(Scratch, ReleasedPagesLeaveTheMemoryAndKeepTheirValues) {
  const int64_t rows = 64, columns = 1 << 18;  // 64 MB
  const at::Tensor tensor = scratch_tensor({rows, columns}, 0);
  const at::Tensor row = at::arange(columns, at::kFloat);
  const int64_t before = resident_bytes();
  for (int64_t i = 0; i < rows; ++i) {
    tensor[i].copy_(row + static_cast<double>(i));
    release_pages(tensor[i]);
  }
  EXPECT_LT(resident_bytes() - before, tensor.nbytes() / 4);
  for (int64_t i = 0; i < rows; ++i)
    ASSERT_TRUE(at::equal(tensor[i], row + static_cast<double>(i)));
  EXPECT_GT(resident_bytes() - before, tensor.nbytes() / 2);  // read again: in memory again
  release_pages(tensor);
  EXPECT_LT(resident_bytes() - before, tensor.nbytes() / 4);
}

TEST(Scratch, OrdinaryTensorsAreLeftAlone) {
  const at::Tensor ordinary = at::arange(1 << 20, at::kFloat), copy = ordinary.clone();
  release_pages(ordinary);
  EXPECT_TRUE(at::equal(ordinary, copy));
  const at::Tensor small = scratch_tensor({1 << 10}).fill_(3);  // below the threshold
  release_pages(small);
  EXPECT_TRUE(small.eq(3).all().item<bool>());
}

TEST(Scratch, WithoutAFolderForFilesItLiesInMemory) {
  const char* given = std::getenv("TMPDIR");
  const std::string before = given == nullptr ? "" : given;
  ::setenv("TMPDIR", "/nowhere", 1);
  const at::Tensor tensor = scratch_tensor({1 << 10}, 0).fill_(2);
  given == nullptr ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", before.c_str(), 1);
  release_pages(tensor);
  EXPECT_TRUE(tensor.eq(2).all().item<bool>());
}

TEST(Random, SameSeedSameNumbers) {
  EXPECT_TRUE(
      torch::equal(torch::randn({8}, make_generator(3)), torch::randn({8}, make_generator(3))));
  EXPECT_FALSE(
      torch::equal(torch::randn({8}, make_generator(3)), torch::randn({8}, make_generator(4))));
}

}  // namespace
}  // namespace freetalk::core
