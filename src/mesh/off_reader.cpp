// OFF to RawMesh, text line by line or binary (big-endian, as Geomview writes it), with or without
// normals, colours and texture coordinates behind the numbers (they are skipped). Not OpenMesh's
// reader: that one loops for as long as a damaged count says and fills what a file that is cut
// short lacks with repetitions.
#include <algorithm>
#include <bit>
#include <charconv>
#include <limits>
#include <string_view>

#include "core/number.h"
#include "freetalk/core/error.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

class OffParser {
 public:
  OffParser(const std::string& file, std::string_view text) : file_(file), text_(text) {}

  RawMesh parse() {
    header();
    return binary_ ? parse_binary() : parse_text();
  }

 private:
  RawMesh parse_text() {
    const int64_t num_vertices = whole_number();
    const int64_t num_faces = whole_number();
    check_counts(num_vertices, num_faces);
    for (int64_t v = 0; v < num_vertices; ++v) {
      next_filled_line();
      Eigen::Vector3d& point = mesh_.vertices.emplace_back();
      for (int axis = 0; axis < 3; ++axis) point[axis] = number();
    }
    for (int64_t f = 0; f < num_faces; ++f) {
      next_filled_line();
      const int64_t corners = whole_number();
      check_corners(corners);
      std::vector<int>& polygon = mesh_.polygons.emplace_back();
      for (int64_t c = 0; c < corners; ++c) polygon.push_back(valid_index(whole_number()));
    }
    return std::move(mesh_);
  }

  /// Counts, then per vertex its floats, then per face its corners and the floats of its colour.
  RawMesh parse_binary() {
    const int64_t num_vertices = word<int32_t>();
    const int64_t num_faces = word<int32_t>();
    word<int32_t>();  // The number of edges, which nobody keeps.
    check_counts(num_vertices, num_faces);
    for (int64_t v = 0; v < num_vertices; ++v) {
      Eigen::Vector3d& point = mesh_.vertices.emplace_back();
      for (int axis = 0; axis < 3; ++axis) point[axis] = word<float>();
      skip_words(extra_floats_);
    }
    for (int64_t f = 0; f < num_faces; ++f) {
      const int64_t corners = word<int32_t>();
      check_corners(corners);
      std::vector<int>& polygon = mesh_.polygons.emplace_back();
      for (int64_t c = 0; c < corners; ++c) polygon.push_back(valid_index(word<int32_t>()));
      skip_words(word<int32_t>());
    }
    return std::move(mesh_);
  }

  void check_counts(int64_t num_vertices, int64_t num_faces) const {
    const auto size = static_cast<int64_t>(text_.size());
    FREETALK_RUNTIME_CHECK(
        num_vertices >= 0 && num_faces >= 0 && num_vertices <= size && num_faces <= size,
        "mesh file ", file_, " promises more elements than it can hold; export it again");
  }

  void check_corners(int64_t corners) const {
    FREETALK_RUNTIME_CHECK(corners >= 0 && corners <= static_cast<int64_t>(text_.size()),
                           "mesh file ", file_, " has a face of impossible size; export it again");
  }

  static int valid_index(int64_t index) {
    const bool valid = index >= 0 && index < std::numeric_limits<int>::max();
    return valid ? static_cast<int>(index) : -1;
  }

  template <class T>
  T word() {
    FREETALK_RUNTIME_CHECK(text_.size() - position_ >= sizeof(uint32_t), "mesh file ", file_,
                           " is damaged or cut short; export it again");
    uint32_t raw = 0;
    for (int i = 0; i < 4; ++i) raw = raw << 8 | static_cast<unsigned char>(text_[position_++]);
    return std::bit_cast<T>(raw);
  }

  void skip_words(int64_t count) {
    const auto left = static_cast<int64_t>((text_.size() - position_) / sizeof(uint32_t));
    FREETALK_RUNTIME_CHECK(count >= 0 && count <= left, "mesh file ", file_,
                           " is damaged or cut short; export it again");
    position_ += static_cast<size_t>(count) * sizeof(uint32_t);
  }
  /// "OFF" after any of ST, C and N (texture coordinates, colours, normals); the counts may follow
  /// on the same line.
  void header() {
    next_filled_line();
    const size_t keyword = line_.find("OFF");
    FREETALK_RUNTIME_CHECK(keyword != std::string_view::npos && keyword <= 5, "mesh file ", file_,
                           " is not an OFF file (it does not start with OFF); check it or export "
                           "it again");
    const std::string_view prefix = line_.substr(0, keyword);
    FREETALK_RUNTIME_CHECK(prefix.find_first_of("4n") == std::string_view::npos, "mesh file ",
                           file_, " has points of more than three dimensions; export it in three");
    const auto has = [&](const char* letter) {
      return prefix.find(letter) != std::string_view::npos ? 1 : 0;
    };
    extra_floats_ = 2 * has("ST") + 4 * has("C") + 3 * has("N");
    line_.remove_prefix(keyword + 3);
    binary_ = line_.find("BINARY") != std::string_view::npos;
    if (!binary_ && blank()) next_filled_line();
  }

  bool blank() const { return line_.find_first_not_of(kBlank) == std::string_view::npos; }

  /// Moves to the next line with something before its comment.
  void next_filled_line() {
    do {
      FREETALK_RUNTIME_CHECK(position_ < text_.size(), "mesh file ", file_,
                             " is damaged or cut short; export it again");
      const size_t end = std::min(text_.find('\n', position_), text_.size());
      line_ = text_.substr(position_, end - position_);
      line_ = line_.substr(0, line_.find('#'));
      position_ = std::min(end + 1, text_.size());
    } while (blank());
  }

  std::string_view token() {
    const size_t begin = std::min(line_.find_first_not_of(kBlank), line_.size());
    const size_t end = std::min(line_.find_first_of(kBlank, begin), line_.size());
    std::string_view result = line_.substr(begin, end - begin);
    line_.remove_prefix(end);
    if (!result.empty() && result.front() == '+') result.remove_prefix(1);
    return result;
  }

  template <class T>
  T parse_token() {
    const std::string_view word = token();
    T value{};
    const char* last = word.data() + word.size();
    std::from_chars_result parsed;
    if constexpr (std::is_floating_point_v<T>) {
      parsed = core::parse_number(word.data(), last, value);
    } else {
      parsed = std::from_chars(word.data(), last, value);
    }
    FREETALK_RUNTIME_CHECK(
        parsed.ec == std::errc() && parsed.ptr == last, "mesh file ", file_,
        " is damaged or cut short (a number is missing or is none); export it again");
    return value;
  }

  int64_t whole_number() { return parse_token<int64_t>(); }
  double number() { return parse_token<double>(); }

  static constexpr std::string_view kBlank = " \t\r";
  const std::string& file_;
  std::string_view text_;
  std::string_view line_;
  size_t position_ = 0;
  bool binary_ = false;
  int64_t extra_floats_ = 0;
  RawMesh mesh_;
};

}  // namespace

RawMesh read_off(const std::filesystem::path& path, const std::string& bytes) {
  const std::string file = path.string();
  return OffParser(file, bytes).parse();
}

}  // namespace freetalk::mesh
