#pragma once
// Which samples belong to the body: strays apart, samples of a cell in clusters, clusters in sheets, handles off.
// Source: README.md, "Outliers" and "Handles".

#include "fitting/sample_cells.h"

namespace celadon {

/// Puts samples with hardly a neighbour in space behind the others: `kept` and the order of every cell.
void set_strays_apart(SampleCells& cells);

/// Clusters of every cell by gaps in the keys of its kept points. Gaps of this share of a cell's diagonal separate, and
/// never less than `smallest_gap_mm`.
void find_clusters(SampleCells& cells, double gap_share, double smallest_gap_mm);

/// Accepts the clusters of the body: the largest sheet and what does not contradict it, without what protrudes between
/// jumps (handles), one cluster where several contradict each other.
void choose_body(SampleCells& cells);

}  // namespace celadon
