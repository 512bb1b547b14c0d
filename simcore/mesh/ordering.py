"""Numbering of nodes and tetrahedra: neighbours in space become neighbours in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee


def cache_order(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The same mesh with nodes in reverse Cuthill-McKee order and tetrahedra by their first node.

    Source: Cuthill, McKee, Reducing the bandwidth of sparse symmetric matrices, Proc. 24th ACM Conf. (1969).
    """
    rows = np.repeat(tets, 4, axis=1).ravel()
    columns = np.tile(tets, (1, 4)).ravel()
    graph = csr_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(nodes), len(nodes)))
    old_of_new = reverse_cuthill_mckee(graph, symmetric_mode=True)
    new_of_old = np.empty(len(nodes), dtype=np.int64)
    new_of_old[old_of_new] = np.arange(len(nodes))
    renumbered = new_of_old[tets]
    renumbered = renumbered[np.lexsort(np.sort(renumbered, axis=1).T[::-1])]
    return np.ascontiguousarray(nodes[old_of_new]), np.ascontiguousarray(renumbered)
