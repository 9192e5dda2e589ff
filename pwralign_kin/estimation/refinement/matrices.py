"""Products and inverses of matrices, in pieces that OpenBLAS leaves to one thread."""

from __future__ import annotations

import numpy as np

from pwralign_kin.se3 import Array

ONE_THREAD = 2**18
"""Multiplications of a matrix product up to which OpenBLAS leaves it to one thread: more of them gain nothing here, and
wait for each other where other work holds the processor."""
INVERTED_WHOLE = 96
"""Size of a matrix up to which the same is true of its inverse."""


def normal_matrix(J: Array, information: Array) -> Array:
    """Return the sum over parts of J' information J (n, n); `J` (parts, 6, n), `information` (parts, 6, 6)."""
    size = J.shape[2]
    rows, weighted = J.reshape(-1, size), (information @ J).reshape(-1, size)
    piece = max(6, ONE_THREAD // size**2)
    H = np.zeros((size, size))
    for first in range(0, len(rows), piece):
        H += rows[first : first + piece].T @ weighted[first : first + piece]
    return H


def inverse_of(H: Array) -> Array:
    """Return the inverse of a symmetric positive definite matrix (n, n), by its Schur complement where OpenBLAS would
    spread it over threads."""
    size = len(H)
    if size <= INVERTED_WHOLE:
        return np.asarray(np.linalg.inv(H))
    half = size // 2
    first = inverse_of(H[:half, :half])
    along = _product(first, H[:half, half:])
    rest = inverse_of(H[half:, half:] - _product(H[half:, :half], along))
    across = -_product(along, rest)
    return np.block([[first - _product(across, along.T), across], [across.T, rest]])


def _product(A: Array, B: Array) -> Array:
    """Return the matrix product, in pieces that OpenBLAS leaves to one thread."""
    piece = max(1, ONE_THREAD // B.size)
    return np.concatenate([A[first : first + piece] @ B for first in range(0, len(A), piece)])
