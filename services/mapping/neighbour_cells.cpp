#include "mapping/neighbour_cells.hpp"

#include <array>

#include "mapping/grid_index.hpp"

namespace zloam::mapping {
namespace {

struct Step {
  int i, j, k;
};

// A cell and its 26 neighbours, the nearest kinds first, so that the search is cut early.
std::array<Step, 27> search_order() {
  std::array<Step, 27> order{};
  std::size_t n = 0;
  for (int away = 0; away <= 3; ++away) {
    for (int i = -1; i <= 1; ++i) {
      for (int j = -1; j <= 1; ++j) {
        for (int k = -1; k <= 1; ++k) {
          if (i * i + j * j + k * k == away) order[n++] = {i, j, k};
        }
      }
    }
  }
  return order;
}
const std::array<Step, 27> kOrder = search_order();

// Distance on one axis from a point, `inside` the cell from its lower side, to the neighbour's box.
double axis_gap(int step, double inside, double edge_m, double margin_m) {
  if (step == 0) return 0.0;
  return std::max(0.0, (step < 0 ? inside : edge_m - inside) - margin_m);
}

}  // namespace

NeighbourCells::NeighbourCells(double radius_m, double margin_m)
    : margin_m_(margin_m), edge_m_(radius_m + margin_m) {}

std::uint32_t NeighbourCells::cell_at(const Eigen::Vector3d& place_map) {
  const GridIndex index = grid_index(place_map, edge_m_);
  const std::uint64_t key = pack_key(index);
  std::uint32_t slot = index_.find(key);
  if (slot != FlatIndex::kNone) return slot;
  if (free_cells_.empty()) {
    slot = static_cast<std::uint32_t>(cells_.size());
    cells_.emplace_back();
  } else {
    slot = free_cells_.back();
    free_cells_.pop_back();
  }
  cells_[slot].key = key;
  cells_[slot].centre = centre_of(index, edge_m_);
  index_.insert(key, slot);
  return slot;
}

void NeighbourCells::add(std::uint32_t id, const Eigen::Vector3d& place_map,
                         const RingRange& rings) {
  const std::uint32_t slot = cell_at(place_map);
  Cell& cell = cells_[slot];
  if (id >= places_.size()) places_.resize(id + std::size_t{1});
  places_[id] = {slot, static_cast<std::uint32_t>(cell.entries.size())};
  cell.entries.push_back({(place_map - cell.centre).cast<float>(), id, rings});
}

void NeighbourCells::move(std::uint32_t id, const Eigen::Vector3d& point_map,
                          const RingRange& rings) {
  const Place& place = places_[id];
  Cell& cell = cells_[place.cell];
  Entry& entry = cell.entries[place.in_cell];
  entry.offset = (point_map - cell.centre).cast<float>();
  entry.rings.join(rings);
}

void NeighbourCells::remove(std::uint32_t id) {
  const Place place = places_[id];
  Cell& cell = cells_[place.cell];
  // The last entry takes the free place.
  cell.entries[place.in_cell] = cell.entries.back();
  places_[cell.entries[place.in_cell].id] = place;
  cell.entries.pop_back();
  if (cell.entries.empty()) {
    index_.erase(cell.key);
    cell.entries.shrink_to_fit();
    free_cells_.push_back(place.cell);
  }
}

std::size_t NeighbourCells::nearest(const Eigen::Vector3d& point_map, double radius_m,
                                    std::span<Neighbour> out) const {
  if (out.empty()) return 0;
  const GridIndex index = grid_index(point_map, edge_m_);
  const Eigen::Vector3d inside = point_map - index.cast<double>() * edge_m_;
  double worst = radius_m * radius_m;
  std::size_t found = 0;
  for (const Step& step : kOrder) {
    const Eigen::Vector3d gap(axis_gap(step.i, inside.x(), edge_m_, margin_m_),
                              axis_gap(step.j, inside.y(), edge_m_, margin_m_),
                              axis_gap(step.k, inside.z(), edge_m_, margin_m_));
    if (gap.squaredNorm() > worst) continue;
    const std::uint32_t slot = index_.find(pack_key(index + GridIndex(step.i, step.j, step.k)));
    if (slot == FlatIndex::kNone) continue;
    const Cell& cell = cells_[slot];
    const Eigen::Vector3f query = (point_map - cell.centre).cast<float>();
    for (const Entry& entry : cell.entries) {
      const double squared = static_cast<double>((entry.offset - query).squaredNorm());
      if (squared >= worst) continue;
      std::size_t at = found < out.size() ? found++ : found - 1;
      for (; at > 0 && out[at - 1].squared_m2 > squared; --at) out[at] = out[at - 1];
      out[at] = {cell.centre + entry.offset.cast<double>(), squared, entry.rings};
      if (found == out.size()) worst = out[found - 1].squared_m2;
    }
  }
  return found;
}

}  // namespace zloam::mapping
