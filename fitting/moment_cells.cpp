#include "fitting/moment_cells.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

namespace celadon {

using assembly_kernels::Translation;

MomentCells cells_of(const MomentGrid& grid) {
  MomentCells cells{grid.layout(), {}, {}, grid.cell(0, 0)};
  cells.edges_z.resize(static_cast<std::size_t>(grid.z_cells() + 1));
  cells.edges_v.resize(static_cast<std::size_t>(grid.v_cells() + 1));
  std::iota(cells.edges_z.begin(), cells.edges_z.end(), 0);
  std::iota(cells.edges_v.begin(), cells.edges_v.end(), 0);
  return cells;
}

CellMap map_cells(std::span<const int> cell_edges, std::span<const int> interval_edges, const char* direction) {
  CellMap map;
  map.placement.resize(cell_edges.size() - 1);
  std::vector<int> ends;  // indices into cell_edges
  for (const int edge : interval_edges) {
    const auto at = std::lower_bound(cell_edges.begin(), cell_edges.end(), edge);
    const int end = static_cast<int>(at - cell_edges.begin());
    if (at == cell_edges.end() || *at != edge || (!ends.empty() && end <= ends.back()))
      throw std::invalid_argument("map_cells: the edge " + std::to_string(edge) + " along " + direction +
                                  " is not the next of the cells' edges");
    ends.push_back(end);
  }
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    const int lo = interval_edges[k], hi = interval_edges[k + 1];
    map.first.push_back(ends[k]);
    map.last.push_back(ends[k + 1]);
    for (auto c = static_cast<std::size_t>(ends[k]); c < static_cast<std::size_t>(ends[k + 1]); ++c) {
      const int start = cell_edges[c], end = cell_edges[c + 1];
      map.placement[c] = {static_cast<double>(start + end - lo - hi) / (hi - lo),
                          static_cast<double>(end - start) / (hi - lo)};
    }
  }
  return map;
}

MergedMoments::MergedMoments(const MomentCells& finer, std::vector<int> edges_z, std::vector<int> edges_v)
    : layout_(finer.layout), edges_z_(std::move(edges_z)), edges_v_(std::move(edges_v)) {
  const int p = layout_.degree_u, q = layout_.degree_v, square = layout_.square();
  const CellMap map_z = map_cells(finer.edges_z, edges_z_, "z"), map_v = map_cells(finer.edges_v, edges_v_, "v");
  std::vector<Translation> along_z;
  for (const auto& at : map_z.placement) along_z.emplace_back(at, 2 * p + 1);
  const auto stride = static_cast<std::size_t>(layout_.stride());
  sums_.assign(map_z.first.size() * map_v.first.size() * stride, 0.0);
  for (std::size_t J = 0; J < map_v.first.size(); ++J) {
    double* column = sums_.data() + J * map_z.first.size() * stride;
    const bool several = map_v.last[J] - map_v.first[J] > 1;
    for (int j = map_v.first[J]; j < map_v.last[J]; ++j) {
      const Translation along_v(map_v.placement[static_cast<std::size_t>(j)], 2 * q + 1);
      assembly_kernels::merge(
          {finer.cell(0, j), layout_, p, q, &map_z.first, &map_z.last, &along_z, several ? &along_v : nullptr}, column);
    }
    for (std::size_t I = 0; I < map_z.first.size(); ++I) {
      double sum = 0;  // no moment: not moved with the others
      for (int j = map_v.first[J]; j < map_v.last[J]; ++j)
        for (int i = map_z.first[I]; i < map_z.last[I]; ++i) sum += finer.cell(i, j)[square];
      column[I * stride + static_cast<std::size_t>(square)] = sum;
    }
  }
}

}  // namespace celadon
