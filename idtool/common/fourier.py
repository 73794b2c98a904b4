"""Lengths of Fourier transforms."""

from __future__ import annotations


def fast_length(least: int) -> int:
    """Length of a fast transform: the smallest number, at least ``least``, with no prime factors but 2, 3 and 5."""
    length = 1 << (least - 1).bit_length()
    power_of_five = 1
    while power_of_five < length:
        odd = power_of_five
        while odd < length:
            quotient = -(-least // odd)
            length = min(length, odd << (quotient - 1).bit_length())
            odd *= 3
        power_of_five *= 5
    return length
