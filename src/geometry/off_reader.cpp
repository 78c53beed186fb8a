// OFF text to RawMesh, line by line, with or without normals, colours and texture coordinates
// behind the numbers (they are skipped). Not OpenMesh's reader: that one loops for as long as a
// damaged count says and fills what a file that is cut short lacks with repetitions.
#include <charconv>
#include <cstdlib>
#include <limits>
#include <string_view>

#include "freetalk/core/error.h"
#include "mesh_file.h"

namespace freetalk::geometry {
namespace {

class OffParser {
 public:
  OffParser(const std::string& file, std::string_view text) : file_(file), text_(text) {}

  RawMesh parse() {
    header();
    const auto size = static_cast<int64_t>(text_.size());
    const int64_t num_vertices = whole_number();
    const int64_t num_faces = whole_number();
    FREETALK_RUNTIME_CHECK(
        num_vertices >= 0 && num_faces >= 0 && num_vertices <= size && num_faces <= size,
        "mesh file ", file_, " promises more elements than it can hold; export it again");
    for (int64_t v = 0; v < num_vertices; ++v) {
      next_filled_line();
      Eigen::Vector3d& point = mesh_.vertices.emplace_back();
      for (int axis = 0; axis < 3; ++axis) point[axis] = number();
    }
    for (int64_t f = 0; f < num_faces; ++f) {
      next_filled_line();
      const int64_t corners = whole_number();
      FREETALK_RUNTIME_CHECK(corners >= 0 && corners <= size, "mesh file ", file_,
                             " has a face of impossible size; export it again");
      std::vector<int>& polygon = mesh_.polygons.emplace_back();
      for (int64_t c = 0; c < corners; ++c) {
        const int64_t index = whole_number();
        const bool valid = index >= 0 && index < std::numeric_limits<int>::max();
        polygon.push_back(valid ? static_cast<int>(index) : -1);
      }
    }
    return std::move(mesh_);
  }

 private:
  /// "OFF" with any of its prefixes (ST, C, N, 4, n); the counts may follow on the same line.
  void header() {
    next_filled_line();
    const size_t keyword = line_.find("OFF");
    FREETALK_RUNTIME_CHECK(keyword != std::string_view::npos && keyword <= 5, "mesh file ", file_,
                           " is not an OFF file (it does not start with OFF); check it or export "
                           "it again");
    FREETALK_RUNTIME_CHECK(line_.find("BINARY") == std::string_view::npos, "mesh file ", file_,
                           " is a binary OFF file, which is not read; export it as text or as PLY");
    line_.remove_prefix(keyword + 3);
    if (blank()) next_filled_line();
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
      position_ = end + 1;
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
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if constexpr (std::is_floating_point_v<T>) {
      if (error == std::errc::result_out_of_range) {
        return std::strtod(std::string(word).c_str(), nullptr);
      }
    }
    FREETALK_RUNTIME_CHECK(
        error == std::errc() && end == word.data() + word.size(), "mesh file ", file_,
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
  RawMesh mesh_;
};

}  // namespace

RawMesh read_off(const std::filesystem::path& path, const std::string& text) {
  const std::string file = path.string();
  return OffParser(file, text).parse();
}

}  // namespace freetalk::geometry
