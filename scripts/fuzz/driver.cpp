// Mutates seed files and opens a door with each, under AddressSanitizer: see scripts/fuzz/run.
//
//   fuzz_NAME [--runs N] [--seed S] [--seconds LIMIT] [--megabytes LIMIT] SEED_FILE...
//
// A finding ends the program (ASan's report, or one line) and leaves the file as finding.EXTENSION.
#include <sanitizer/common_interface_defs.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "driver.h"

// Of <sanitizer/allocator_interface.h>, which GCC does not install.
extern "C" {
size_t __sanitizer_get_allocated_size(const void* pointer);
int __sanitizer_install_malloc_and_free_hooks(void (*on_malloc)(const volatile void*, size_t),
                                              void (*on_free)(const volatile void*));
}

namespace {

namespace fs = std::filesystem;

struct Seed {
  std::string extension;
  std::string bytes;
};

struct Settings {
  int64_t runs = 10000;
  uint64_t seed = 0;
  unsigned seconds = 10;
  int64_t megabytes = 512;
  std::vector<Seed> seeds;
};

// What the input now in the door is called, for the signal handler and ASan's callback.
fs::path current_file, finding_file;

std::atomic<int64_t> live_bytes{0}, peak_bytes{0};

void on_malloc(const volatile void* pointer, size_t) {
  const auto size =
      static_cast<int64_t>(__sanitizer_get_allocated_size(const_cast<const void*>(pointer)));
  const int64_t live = live_bytes += size;
  int64_t peak = peak_bytes;
  while (live > peak && !peak_bytes.compare_exchange_weak(peak, live)) {
  }
}

void on_free(const volatile void* pointer) {
  if (pointer == nullptr) return;
  live_bytes -=
      static_cast<int64_t>(__sanitizer_get_allocated_size(const_cast<const void*>(pointer)));
}

void keep_finding() {
  std::error_code error;
  fs::copy_file(current_file, finding_file, fs::copy_options::overwrite_existing, error);
  std::fprintf(stderr, "the file is kept as %s\n", finding_file.c_str());
}

void on_alarm(int) {
  constexpr char kText[] = "FINDING: the time limit has passed\n";
  if (write(2, kText, sizeof(kText) - 1) < 0) std::_Exit(2);
  keep_finding();
  std::_Exit(1);
}

[[noreturn]] void finding(const std::string& what) {
  std::fprintf(stderr, "FINDING: %s\n", what.c_str());
  keep_finding();
  std::_Exit(1);
}

class Mutator {
 public:
  Mutator(const std::vector<Seed>& seeds, uint64_t seed) : seeds_(seeds), random_(seed) {}

  Seed next() {
    Seed result = seeds_[below(seeds_.size())];
    const size_t changes = 1 + below(below(4) == 0 ? 16 : 3);
    for (size_t i = 0; i < changes; ++i) change(result);
    return result;
  }

 private:
  size_t below(size_t bound) {
    return bound == 0 ? 0 : std::uniform_int_distribution<size_t>(0, bound - 1)(random_);
  }

  void change(Seed& seed) {
    std::string& bytes = seed.bytes;
    const size_t at = below(bytes.size() + 1);
    const size_t length =
        below(std::min<size_t>(bytes.size() - std::min(at, bytes.size()), 64) + 1);
    switch (below(9)) {
      case 0:
        if (at < bytes.size()) bytes[at] = static_cast<char>(bytes[at] ^ (1 << below(8)));
        break;
      case 1:
        if (at < bytes.size()) bytes[at] = static_cast<char>(below(256));
        break;
      case 2:
        bytes.erase(at, length);
        break;
      case 3:
        bytes.insert(at, bytes.substr(below(bytes.size()), length));
        break;
      case 4:
        bytes.resize(at);
        break;
      case 5:
        overwrite_number(bytes, at);
        break;
      case 6:
        replace_word(bytes, at);
        break;
      case 7: {  // The rest of another seed.
        const std::string& other = seeds_[below(seeds_.size())].bytes;
        bytes = bytes.substr(0, at) + other.substr(below(other.size()));
        break;
      }
      default:
        bytes.insert(at, 1 + below(8), static_cast<char>(below(256)));
    }
  }

  /// A binary number that readers trip over.
  void overwrite_number(std::string& bytes, size_t at) {
    constexpr std::array<uint32_t, 10> kNumbers{0,          1,          0x7FFFFFFF, 0x80000000,
                                                0xFFFFFFFF, 0xFFFFFFFE, 0x01000000, 0x7F800000,
                                                0x7FC00000, 0x00010000};
    const uint32_t value = kNumbers[below(kNumbers.size())];
    const size_t width = below(2) == 0 ? 4 : 2;
    if (at + width <= bytes.size()) std::memcpy(bytes.data() + at, &value, width);
  }

  /// A word of text for another: numbers that readers trip over, nothing, a very long one.
  void replace_word(std::string& bytes, size_t at) {
    static const std::vector<std::string> kWords{
        "0",     "-1",         "4294967295", "2147483648", "99999999999999999999",
        "1e400", "1e-400",     "nan",        "-inf",       "",
        "\n",    "1/1/1",      "//",         "\\\n",       "0x10",
        "-0",    "1000000000", "list",       "}",          "[[[[",
        "\"x\":"};
    constexpr const char* kBlank = " \t\r\n,:/[]{}\"";
    const size_t begin = std::min(bytes.find_first_not_of(kBlank, at), bytes.size());
    const size_t end = std::min(bytes.find_first_of(kBlank, begin), bytes.size());
    if (end - begin > 64) return;  // Binary.
    const std::string word =
        below(20) == 0 ? std::string(100000, "0(-"[below(3)]) : kWords[below(kWords.size())];
    bytes.replace(begin, end - begin, word);
  }

  const std::vector<Seed>& seeds_;
  std::mt19937_64 random_;
};

Settings parse(int argc, char** argv) {
  Settings settings;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto number = [&] { return i + 1 < argc ? std::strtoll(argv[++i], nullptr, 10) : 0; };
    if (word == "--runs") {
      settings.runs = number();
    } else if (word == "--seed") {
      settings.seed = static_cast<uint64_t>(number());
    } else if (word == "--seconds") {
      settings.seconds = static_cast<unsigned>(number());
    } else if (word == "--megabytes") {
      settings.megabytes = number();
    } else {
      std::ifstream stream(word, std::ios::binary);
      settings.seeds.push_back(
          {fs::path(word).extension().string(), {std::istreambuf_iterator<char>(stream), {}}});
    }
  }
  return settings;
}

}  // namespace

int main(int argc, char** argv) {
  const Settings settings = parse(argc, argv);
  if (settings.seeds.empty()) {
    std::fprintf(stderr, "usage: %s [--runs N] [--seed S] SEED_FILE...\n", argv[0]);
    return 2;
  }
  const fs::path folder = fs::temp_directory_path() / ("freetalk_fuzz_" + std::to_string(getpid()));
  fs::create_directories(folder);
  __sanitizer_set_death_callback(keep_finding);
  __sanitizer_install_malloc_and_free_hooks(on_malloc, on_free);
  std::signal(SIGALRM, on_alarm);
  Mutator mutator(settings.seeds, settings.seed);
  int64_t read = 0, most_bytes = 0;
  double slowest = 0.0;
  // The seeds themselves first: each must be read.
  const auto count = static_cast<int64_t>(settings.seeds.size());
  for (int64_t run = -count; run < settings.runs; ++run) {
    const Seed input = run < 0 ? settings.seeds[static_cast<size_t>(run + count)] : mutator.next();
    current_file = folder / ("input" + input.extension);
    finding_file = "finding" + input.extension;
    std::ofstream(current_file, std::ios::binary) << input.bytes;
    const int64_t before = live_bytes;
    peak_bytes = before;
    alarm(settings.seconds);
    const auto start = std::chrono::steady_clock::now();
    bool opened = false;
    try {
      opened = freetalk::fuzz::open_door(current_file);
    } catch (const std::exception& error) {
      finding(std::string("an error that is not ours: ") + error.what());
    }
    alarm(0);
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    slowest = std::max(slowest, took.count());
    most_bytes = std::max(most_bytes, peak_bytes - before);
    if (most_bytes > settings.megabytes << 20) finding("more memory than the limit");
    if (run < 0 && !opened) finding("a seed was refused");
    read += run >= 0 && opened ? 1 : 0;
  }
  fs::remove_all(folder);
  std::printf("%lld mutated files: %lld read, %lld refused; slowest %.0f ms, most memory %.1f MB\n",
              static_cast<long long>(settings.runs), static_cast<long long>(read),
              static_cast<long long>(settings.runs - read), 1e3 * slowest,
              static_cast<double>(most_bytes) / (1 << 20));
  return 0;
}
