"""Sparse matrices times dense tables, whole or in parts.

Knows rows of columns and values; knows nothing of what they stand for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch


@dataclass(frozen=True)
class SparseRows:
    """Rows of a sparse matrix. offsets: (rows,) start of each; columns: (nnz,); values: (nnz,) float32."""

    offsets: torch.Tensor
    columns: torch.Tensor
    values: torch.Tensor

    def times(self, table: torch.Tensor) -> torch.Tensor:
        """This matrix times a dense table (columns, C): (rows, C)."""
        # The fastest such product of torch on a CPU, and it runs on CUDA as well. Not by way of
        # torch.nn.functional, whose checks cost 25 microseconds a call. Mode 0 sums.
        bags = torch.embedding_bag(table, self.columns, self.offsets, mode=0, per_sample_weights=self.values)
        return bags[0]

    def transposed(self, count: int) -> SparseRows:
        """The transpose, a row for each of `count` columns."""
        from scipy import sparse  # here, since it would add to the cost of importing the map

        ends = np.append(self.offsets.cpu().numpy(), np.int32(len(self.values)))
        parts = self.values.cpu().numpy(), self.columns.cpu().numpy(), ends
        turned = sparse.csr_matrix(parts, (len(self.offsets), count)).tocsc()
        arrays = turned.indptr[:-1].astype(np.int32), turned.indices.astype(np.int32), turned.data
        return SparseRows(*(torch.from_numpy(a).to(self.values.device) for a in arrays))

    def squared(self) -> SparseRows:
        """Every value squared."""
        return replace(self, values=self.values.square())

    def split(self, count: int, row_cost: int = 0) -> list[SparseRows]:
        """Consecutive parts of about the same cost: one for each value, row_cost for each row."""
        cost = self.offsets + row_cost * torch.arange(len(self.offsets)).to(self.offsets)
        whole = len(self.values) + row_cost * len(self.offsets)
        wanted = torch.arange(1, count) * (whole // count)
        cuts = torch.searchsorted(cost, wanted.to(cost)).tolist()
        ends = [0, *cuts, len(self.offsets)]
        return [self.part(slice(a, b)) for a, b in pairwise(ends) if b > a]

    def part(self, rows: slice) -> SparseRows:
        """Some consecutive rows, without a copy of their values."""
        last = int(self.offsets[rows.stop]) if rows.stop < len(self.offsets) else len(self.columns)
        first = int(self.offsets[rows.start]) if rows.start < len(self.offsets) else last
        return SparseRows(self.offsets[rows] - first, self.columns[first:last], self.values[first:last])
