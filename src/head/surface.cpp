#include "freetalk/head/surface.h"

#include <torch/torch.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <optional>
#include <utility>

#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/geometry/isosurface.h"
#include "head/canonical_grid.h"
#include "head/lattice.h"

namespace freetalk::head {
namespace {

constexpr uint8_t kVisited = 1;    // a cell, by its lower corner
constexpr double kLeastSlope = 1;  // of a distance
constexpr int kOffsets[8][3] = {{0, 0, 0}, {0, 0, 1}, {0, 1, 0}, {0, 1, 1},
                                {1, 0, 0}, {1, 0, 1}, {1, 1, 0}, {1, 1, 1}};

/// Distances at points (N, 3): (N,).
using Field = std::function<at::Tensor(const at::Tensor&)>;

/// A grid over the head's box.
struct Box {
  Box(const HeadOptions& head, int64_t cells) : side(cells + 1) {
    for (size_t axis = 0; axis < 3; ++axis) {
      low[axis] = head.box_min[axis];
      spacing[axis] = (head.box_max[axis] - head.box_min[axis]) / static_cast<double>(cells);
    }
  }
  /// The place of fractions of the grid's cells.
  void place(const double* at, float* point) const {
    for (size_t axis = 0; axis < 3; ++axis) {
      point[axis] = static_cast<float>(low[axis] + at[axis] * spacing[axis]);
    }
  }
  double half_diagonal() const { return 0.5 * std::hypot(spacing[0], spacing[1], spacing[2]); }
  bool at_edge(const std::array<int64_t, 3>& corner) const {
    return std::any_of(corner.begin(), corner.end(),
                       [this](int64_t c) { return c == 0 || c == side - 1; });
  }

  int64_t side;
  double low[3], spacing[3];
};

/// Cells of the coarse grid that the surface may cross.
std::vector<std::array<int64_t, 3>> pruned_cells(const Field& field, const Box& box, int64_t cells,
                                                 double safety, int64_t* evaluations) {
  at::Tensor centres = at::empty({cells * cells * cells, 3}, at::kFloat);
  auto* to = centres.mutable_data_ptr<float>();
  for (int64_t x = 0; x < cells; ++x) {
    for (int64_t y = 0; y < cells; ++y) {
      for (int64_t z = 0; z < cells; ++z, to += 3) {
        const double at[3] = {static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5,
                              static_cast<double>(z) + 0.5};
        box.place(at, to);
      }
    }
  }
  *evaluations += centres.size(0);
  const at::Tensor s = field(centres).view({cells, cells, cells});
  const double reach = 4 * box.half_diagonal();
  double slope = kLeastSlope;
  for (int64_t axis = 0; axis < 3; ++axis) {
    const at::Tensor a = s.narrow(axis, 1, cells - 1), b = s.narrow(axis, 0, cells - 1);
    const at::Tensor near = at::minimum(a.abs(), b.abs()) < reach;
    const at::Tensor steps = at::where(near, (a - b).abs(), at::zeros_like(a));
    slope = std::max(slope, steps.max().item<double>() / box.spacing[axis]);
  }
  const at::Tensor kept = (s.abs() <= safety * slope * box.half_diagonal()).nonzero();
  std::vector<std::array<int64_t, 3>> result;
  const auto* from = kept.const_data_ptr<int64_t>();
  for (int64_t row = 0; row < kept.size(0); ++row, from += 3) {
    result.push_back({from[0], from[1], from[2]});
  }
  return result;
}

}  // namespace

void SurfaceOptions::check() const {
  FREETALK_CHECK(coarse >= 4 && resolution % (4 * coarse) == 0,
                 "surface: resolution must be a multiple of 4 coarse = ", 4 * coarse, ", found ",
                 resolution);
  FREETALK_CHECK(resolution <= 2048, "surface: resolution must be at most 2048, found ",
                 resolution);
  FREETALK_CHECK(safety >= 1, "surface: safety must be at least 1, found ", safety);
  FREETALK_CHECK(at_box == "close" || at_box == "open" || at_box == "error",
                 "surface: at_box must be close, open or error, found ", at_box);
}

struct SurfaceExtractor::State {
  State(const PreparedHead& prepared, const SurfaceOptions& surface, const SmoothingOptions& smooth)
      : head(prepared),
        pruning(prepared.head(), prepared.z_id(), {"bfloat16"}),
        options(surface),
        smoothing(smooth),
        box(prepared.options(), surface.resolution),
        lattice(box.side) {
    options.check();
    smoothing.check();
  }

  /// The posed field under an expression; `grid` where canonical distances are interpolated.
  Field posed(const PreparedHead& of, const at::Tensor& z_exp, CanonicalGrid* with) const {
    const bool smooth = smoothing.mode != "none";
    return [this, &of, z_exp, with, smooth](const at::Tensor& points) {
      CanonicalPoints moved = of.to_canonical(points, z_exp);
      if (smooth) {
        const at::Tensor rest =
            smoothing.mode == "rest"
                ? of.to_canonical(points, of.head()->rest_expression).points - points
                : at::Tensor();
        moved.points =
            points + smoothed_offsets(of, points, moved.points - points, rest, smoothing);
      }
      if (with != nullptr) return with->sdf(moved.points);
      return of.unfaded_sdf(moved.points, z_exp, moved.hyper);
    };
  }

  /// Asks the field at corners that have no value yet.
  void ask(const Field& field, const std::vector<int64_t>& corners) {
    std::vector<int64_t> missing;
    for (const int64_t corner : corners) {
      float& value = lattice.value(corner);
      if (!std::isnan(value)) continue;
      value = 0;  // asked for
      missing.push_back(corner);
    }
    if (missing.empty()) return;
    evaluations += static_cast<int64_t>(missing.size());
    const at::Tensor values = field(lattice.points(missing, box.low, box.spacing));
    FREETALK_RUNTIME_CHECK(values.isfinite().all().item<bool>(),
                           "extract: the field is not finite: check the codes and the weights");
    const auto* from = values.const_data_ptr<float>();
    const auto outside = static_cast<float>(box.half_diagonal());
    for (const int64_t corner : missing) {
      float& value = lattice.value(corner);
      value = *from++;
      if (options.at_box == "open" || !box.at_edge(lattice.place(corner))) continue;
      FREETALK_RUNTIME_CHECK(options.at_box == "close" || value > 0,
                             "extract: the surface leaves the head's box; enlarge box_min and "
                             "box_max, or let at_box close it");
      value = std::max(value, outside);
    }
  }

  /// Fine cells that the surface crosses, found along the edges of a lattice of kept coarse cells.
  std::vector<int64_t> seeds(const Field& field, const Field& coarse_field) {
    const Box coarse(head.options(), options.coarse);
    const auto kept =
        pruned_cells(coarse_field, coarse, options.coarse, options.safety, &evaluations);
    const int64_t stride = options.resolution / options.coarse / 4, width = 4 * stride;
    std::vector<int64_t> corners;
    const auto each = [&](const auto& visit) {
      for (const auto& cell : kept) {
        for (int64_t x = 0; x <= 4; ++x) {
          for (int64_t y = 0; y <= 4; ++y) {
            for (int64_t z = 0; z <= 4; ++z) {
              visit(
                  std::array<int64_t, 3>{cell[0] * width + x * stride, cell[1] * width + y * stride,
                                         cell[2] * width + z * stride},
                  std::array<int64_t, 3>{x, y, z});
            }
          }
        }
      }
    };
    each([&](const auto& at, const auto&) { corners.push_back(lattice.id(at[0], at[1], at[2])); });
    std::sort(corners.begin(), corners.end());
    corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
    ask(field, corners);
    std::vector<std::pair<int64_t, int64_t>> edges;
    each([&](const auto& at, const auto& in_cell) {
      const int64_t a = lattice.id(at[0], at[1], at[2]);
      for (size_t axis = 0; axis < 3; ++axis) {
        if (in_cell[axis] == 4) continue;
        auto other = at;
        other[axis] += stride;
        const int64_t b = lattice.id(other[0], other[1], other[2]);
        if ((lattice.value(a) < 0) != (lattice.value(b) < 0)) edges.emplace_back(a, b);
      }
    });
    return bisected(field, std::move(edges), stride);
  }

  /// The fine cells at crossed edges of `length` cells, halved until they are one cell long.
  std::vector<int64_t> bisected(const Field& field, std::vector<std::pair<int64_t, int64_t>> edges,
                                int64_t length) {
    std::sort(edges.begin(), edges.end());
    edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
    for (; length > 1; length = (length + 1) / 2) {
      std::vector<int64_t> middles;
      for (const auto& [a, b] : edges) middles.push_back(middle(a, b));
      ask(field, middles);
      for (auto& [a, b] : edges) {
        const int64_t m = middle(a, b);
        ((lattice.value(a) < 0) == (lattice.value(m) < 0) ? a : b) = m;
      }
    }
    std::vector<int64_t> cells;
    for (const auto& edge : edges) {
      auto place = lattice.place(edge.first);
      for (int64_t& c : place) c = std::min(c, box.side - 2);
      cells.push_back(lattice.id(place[0], place[1], place[2]));
    }
    return cells;
  }

  int64_t middle(int64_t a, int64_t b) const {
    const auto p = lattice.place(a), q = lattice.place(b);
    return lattice.id((p[0] + q[0]) / 2, (p[1] + q[1]) / 2, (p[2] + q[2]) / 2);
  }

  int64_t corner_of(int64_t cell, int corner) const {
    const int* o = kOffsets[corner];
    return cell + (o[0] * box.side + o[1]) * box.side + o[2];
  }

  /// Follows the surface through crossed faces.
  std::vector<int64_t> follow(const Field& field, std::vector<int64_t> frontier) {
    std::vector<int64_t> crossed;
    while (!frontier.empty()) {
      std::vector<int64_t> fresh, corners;
      for (const int64_t cell : frontier) {
        uint8_t& mark = lattice.mark(cell);
        if (mark & kVisited) continue;
        mark |= kVisited;
        fresh.push_back(cell);
        for (int corner = 0; corner < 8; ++corner) corners.push_back(corner_of(cell, corner));
      }
      ask(field, corners);
      frontier.clear();
      for (const int64_t cell : fresh) {
        if (add_neighbours(cell, frontier)) crossed.push_back(cell);
      }
    }
    return crossed;
  }

  /// Whether the surface crosses a cell; its neighbours beyond crossed faces join the frontier.
  bool add_neighbours(int64_t cell, std::vector<int64_t>& frontier) {
    bool inside[8], any = false, all = true;
    for (int corner = 0; corner < 8; ++corner) {
      inside[corner] = lattice.value(corner_of(cell, corner)) < 0;
      any = any || inside[corner];
      all = all && inside[corner];
    }
    if (!any || all) return false;
    const auto place = lattice.place(cell);
    for (size_t axis = 0; axis < 3; ++axis) {
      for (int upper = 0; upper < 2; ++upper) {
        int below = 0;
        for (int corner = 0; corner < 8; ++corner) {
          below += kOffsets[corner][axis] == upper && inside[corner];
        }
        if (below == 0 || below == 4) continue;
        auto next = place;
        next[axis] += upper ? 1 : -1;
        if (next[axis] < 0 || next[axis] > box.side - 2) continue;
        frontier.push_back(lattice.id(next[0], next[1], next[2]));
      }
    }
    return true;
  }

  Surface mesh(std::vector<int64_t> crossed) {
    std::sort(crossed.begin(), crossed.end());
    std::vector<int64_t> corners;
    geometry::CellCorners cells(static_cast<Eigen::Index>(crossed.size()), 8);
    for (size_t cell = 0; cell < crossed.size(); ++cell) {
      for (int corner = 0; corner < 8; ++corner) {
        const int64_t id = corner_of(crossed[cell], corner);
        int32_t& number = lattice.number(id);
        if (number < 0) {
          number = static_cast<int32_t>(corners.size());
          corners.push_back(id);
        }
        cells(static_cast<Eigen::Index>(cell), corner) = number;
      }
    }
    const auto count = static_cast<Eigen::Index>(corners.size());
    Eigen::MatrixXd places(count, 3);
    Eigen::VectorXf values(count);
    for (Eigen::Index row = 0; row < count; ++row) {
      const int64_t corner = corners[static_cast<size_t>(row)];
      const auto place = lattice.place(corner);
      for (int axis = 0; axis < 3; ++axis) {
        const auto at = static_cast<double>(place[static_cast<size_t>(axis)]);
        places(row, axis) =
            (box.low[axis] + at * box.spacing[axis]) / head.options().units_per_metre;
      }
      values[row] = lattice.value(corner);
    }
    auto found = geometry::isosurface_of_cells(places, values, cells);
    last_cells = std::move(crossed);
    return {std::move(found.vertices), std::move(found.faces), evaluations};
  }

  Surface run(const at::Tensor& z_exp, bool sequence) {
    return core::with_plain_errors("extract", [&] {
      const at::NoGradGuard no_grad;
      const HeadOptions& own = head.options();
      const bool interpolates = sequence && options.canonical_grid && own.identity_sees == "none";
      if (interpolates && !grid) grid.emplace(head, options.resolution);
      const int64_t asked = grid ? grid->num_evaluations() : 0;
      const Field field = posed(head, z_exp, interpolates ? &*grid : nullptr);
      lattice.clear();
      evaluations = 0;
      std::vector<int64_t> crossed;
      if (sequence && !last_cells.empty()) crossed = follow(field, last_cells);
      if (crossed.empty()) {
        lattice.clear();
        crossed = follow(field, seeds(field, posed(pruning, z_exp, nullptr)));
      }
      FREETALK_RUNTIME_CHECK(!crossed.empty(),
                             "extract: there is no surface within the head's box under this code");
      if (grid) evaluations += grid->num_evaluations() - asked;
      return mesh(std::move(crossed));
    });
  }

  PreparedHead head, pruning;
  SurfaceOptions options;
  SmoothingOptions smoothing;
  Box box;
  Lattice lattice;
  std::optional<CanonicalGrid> grid;
  std::vector<int64_t> last_cells;
  int64_t evaluations = 0;
};

SurfaceExtractor::SurfaceExtractor(const PreparedHead& head, const SurfaceOptions& options,
                                   const SmoothingOptions& smoothing) {
  options.check();
  state_ = std::make_unique<State>(head, options, smoothing);
}
SurfaceExtractor::~SurfaceExtractor() = default;
SurfaceExtractor::SurfaceExtractor(SurfaceExtractor&&) noexcept = default;

Surface SurfaceExtractor::extract(const at::Tensor& z_exp) { return state_->run(z_exp, false); }
Surface SurfaceExtractor::next(const at::Tensor& z_exp) { return state_->run(z_exp, true); }

}  // namespace freetalk::head
