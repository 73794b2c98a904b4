"""Zero-phase filters with kernels of finite length, so that a log taken in pieces gives what the whole gives.

Shapes: N samples, n after decimation; the last axis is time.
"""

from __future__ import annotations

import math

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.fourier import fast_length

_MAX_MISSING_WEIGHT = 0.02  # of a kernel's weight may be missing at an end of the data
_MAX_CUT_WEIGHT = 1e-6  # of a kernel's weight may be cut off
_BLOCK_OUTPUTS = 16  # filtered samples that one product gives, an even number; with more, more of it is zeros
# Maximally flat central difference, 4 samples to each side: within 1 % up to a fifth of the sampling rate.
_DIFFERENCE_KERNEL = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
DIFFERENCE_REACH = len(_DIFFERENCE_KERNEL) // 2
DELAY_REACH = 4  # samples before, and one less after, from which one in between follows


class LowPass:
    """A zero-phase Butterworth low-pass that decimates to its band.

    The kernel is the impulse response of the filter run forwards and backwards, cut where what is left of it weighs
    less than 1e-6. At an end of the data it is cut short and scaled to the weight that is left.

    Parameters
    ----------
    cutoff
        Corner frequency of one pass [Hz]; the two passes together are 6 dB down there.
    order
        Of one pass.
    dt
        Sample time [s].
    stride
        Every how many samples to keep one.
    """

    def __init__(self, cutoff: float, order: int, dt: float, stride: int = 1) -> None:
        self.stride = stride
        kernel = zero_phase_butterworth(order, cutoff * dt)
        weight = np.cumsum(np.abs(kernel[: len(kernel) // 2 + 1]))
        cut = int(np.searchsorted(weight, _MAX_CUT_WEIGHT * weight[-1]))
        kernel = kernel[cut : len(kernel) - cut]
        # Zeros make the kernel reach over whole blocks, so that a batch of whole blocks is filtered where it lies.
        self.block = _BLOCK_OUTPUTS * stride
        self.kernel: Array = np.pad(kernel / kernel.sum(), -(len(kernel) // 2) % (self.block // 2))
        self.reach = len(self.kernel) // 2
        self._taps = self._taps_of(self.kernel)
        self._weight_taps = self._taps_of(np.abs(self.kernel) / np.abs(self.kernel).sum())
        self._end_weights: dict[tuple[int, int, int], Array] = {}  # batches at an end have few lengths
        # Closer to an end than this, more than 2 % of the weight is missing and what comes out is not of the band.
        beyond = np.abs(np.cumsum(self.kernel)[: self.reach]) > _MAX_MISSING_WEIGHT
        self.edge = self.reach - int(np.argmax(beyond))

    @property
    def redundancy(self) -> float:
        """Number of kept samples of white noise that are worth one independent sample."""
        return max(1.0, 1 / (self.stride * float(self.kernel @ self.kernel)))

    def __call__(self, x: Array, before: int, after: int) -> Array:
        """Filter and decimate.

        Parameters
        ----------
        x
            Shape (..., before + N + after).
        before, after
            Samples of x that serve as surroundings only: `reach`, or fewer at an end of the data.

        Returns
        -------
        Samples 0, stride, 2 stride, … of the N, filtered; shape (..., ceil(N / stride)).
        """
        samples = x.shape[-1] - before - after
        outputs = slice(-(-samples // self.stride))
        padding = (self.reach - before, self.reach - after + -samples % self.block)
        if not any(padding):
            return _convolve(x, self._taps)[..., outputs]
        weight = self._weight_at_ends(x.shape[-1], *padding)
        return _convolve(_padded(x, *padding), self._taps)[..., outputs] / weight[outputs]

    def _weight_at_ends(self, length: int, before: int, after: int) -> Array:
        """Share of the kernel's weight on a batch, not on the zeros around it, at each output; shape (n,)."""
        key = length, before, after
        if key not in self._end_weights:
            self._end_weights[key] = _convolve(_padded(np.ones(length), before, after), self._taps)
        return self._end_weights[key]

    def masked_share(self, mask: Mask, before: int, after: int) -> Array:
        """Share of each filtered sample's weight, by magnitude, that comes from the masked samples; shape (n,)."""
        samples = len(mask) - before - after
        padded = _padded(mask.astype(float), self.reach - before, self.reach - after + -samples % self.block)
        return _convolve(padded, self._weight_taps)[: -(-samples // self.stride)]

    def _taps_of(self, kernel: Array) -> Array:
        """A kernel's factors for the samples of each block that the outputs of one block depend on."""
        taps = np.zeros((2 * self.reach + self.block, _BLOCK_OUTPUTS))
        for i, column in enumerate(taps.T):
            column[i * self.stride : i * self.stride + len(kernel)] = kernel
        return taps.reshape(-1, self.block, _BLOCK_OUTPUTS)


def _padded(x: Array, before: int, after: int) -> Array:
    """Samples with zeros before and after them, along the last axis; much faster than numpy's pad."""
    length = x.shape[-1]
    padded = np.zeros((*x.shape[:-1], before + length + after))
    padded[..., before : before + length] = x
    return padded


def _convolve(x: Array, taps: Array) -> Array:
    """A kernel's sums over whole blocks: block i of the output is Σ_d (block i + d of x) · taps[d]."""
    blocks = x.reshape(*x.shape[:-1], -1, taps.shape[1])
    count = blocks.shape[-2] - len(taps) + 1
    sums = blocks[..., :count, :] @ taps[0]
    for d, own in enumerate(taps[1:], start=1):
        sums += blocks[..., d : d + count, :] @ own
    return np.asarray(sums.reshape(*x.shape[:-1], -1))


def convolve(x: Array, kernel: Array) -> Array:
    """Convolution by Fourier transforms, shapes (N,) and (K,) to (N + K − 1,)."""
    length = len(x) + len(kernel) - 1
    size = fast_length(length)
    return np.asarray(np.fft.irfft(np.fft.rfft(x, size) * np.fft.rfft(kernel, size), size)[:length])


def zero_phase_butterworth(order: int, cutoff: float) -> Array:
    """Impulse response of a zero-phase Butterworth low-pass, shape (2n − 1,); the middle is at time 0.

    The filter is run forwards and backwards. Its gain is the square of the gain of one pass, which by the bilinear
    transform is 1 / (1 + (tan(πf) / tan(πf_c))^(2 order)); the response is the inverse Fourier transform of it. The
    grid is so long that the response has died away at its ends.

    Parameters
    ----------
    order
        Of one pass, 1 to 8.
    cutoff
        Corner frequency of one pass as a fraction of the sampling rate, below 0.5.

    Source: Oppenheim & Schafer, Discrete-Time Signal Processing, section 7.2
    """
    # Long enough for the slowest pole of any order up to 8 to die away; near half the rate it is as slow as near 0.
    reach = math.ceil(20 / min(cutoff, 0.5 - cutoff))
    grid = 4 * reach
    with np.errstate(over="ignore"):  # half the rate is where the gain is 0
        ratio = np.tan(np.pi * np.fft.rfftfreq(grid)) / math.tan(math.pi * cutoff)
        squared_gain = 1 / (1 + ratio ** (2 * order))
    response = np.fft.irfft(squared_gain, grid)
    return np.concatenate([response[reach - 1 : 0 : -1], response[:reach]])


def differentiate(x: Array, dt: float) -> Array:
    """Time derivative; 4 samples shorter at each end. Shape (nv, N) to (nv, N − 8)."""
    windows = np.lib.stride_tricks.sliding_window_view(x, len(_DIFFERENCE_KERNEL), axis=-1)
    return np.asarray(windows @ _DIFFERENCE_KERNEL / dt)


def delay_signal(x: Array, samples: float) -> Array:
    """Delay a signal by a fraction of a sample; 4 samples shorter at the beginning and 3 at the end.

    By the polynomial of degree 7 through the nearest samples: to a fifth of the sampling rate within 1 %, where a
    straight line loses up to 19 % of the amplitude.

    Parameters
    ----------
    x
        Shape (..., N).
    samples
        Delay in samples, from 0 to below 1.

    Returns
    -------
    Shape (..., N − 7).
    """
    nodes = np.arange(-DELAY_REACH, DELAY_REACH)
    differences = nodes[:, None] - nodes + np.eye(len(nodes))
    factors = (-samples - nodes) / differences
    np.fill_diagonal(factors, 1.0)
    windows = np.lib.stride_tricks.sliding_window_view(x, len(nodes), axis=-1)
    return np.asarray(windows @ factors.prod(axis=1))


def noise_above_band(x: Array, low_pass: LowPass) -> Array:
    """Robust standard deviation of what lies above the band, shape (nv,)."""
    above = x - low_pass(x, 0, 0)
    deviation = np.abs(above - np.median(above, axis=1, keepdims=True))
    return np.asarray(1.4826 * np.median(deviation, axis=1))
