"""Vectors of numbers as values of numba kernels, atomic numbers, and memory that begins on cache lines.

numba's compiler finds vectors in long loops, not in the four or sixteen steps of one access, and it has neither vector
types nor atomic loads. Here they are types and small operations; kernels stay plain Python. LLVM gives every operation
the width that the processor has.
"""
