"""Elementary functions of the machine code, used instead of those of the C library.

Each function is written once, for numbers, lanes and Python, with IEEE 754 operations that every processor rounds
alike: sums, products, quotients, square roots, comparisons and operations on integers, without fused multiplications.
Its results are therefore the same bits everywhere. Special values follow IEEE 754 and Annex F of C99.
"""
