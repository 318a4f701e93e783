"""Exact sums over the patches and fates of a bench, that a kernel adds to."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ..results.tally import Fate, Tally

__all__ = ["Sums", "packet_width"]


class Sums:
    """Sums over the bins of a bench that a kernel scatters to.

    A bin holds hits, the excess of their powers over 1, and for each further channel
    the excess over the first: side by side, since Dr.Jit adds such a packet in one go,
    three times as fast as one number alone. Where that is not so, in large collectors,
    zeros are skipped: counted rays and achromatic specimens cost one addition.

    A patch's bin holds the rays that arrived there. With `deposits` it holds what
    `deposit` adds, and the rays are in the bins of their fates. Direct light is in the
    bin of its fate as well, with its power.
    """

    def __init__(self, bench, scale, n_batches=1, *, deposits=False):
        self.bench = bench
        self.scale = scale
        self.n_batches = n_batches
        self.deposits = deposits
        self.channels = len(mi.Spectrum())
        self.width = packet_width()
        self.bins = dr.zeros(mi.Int64, n_batches * bench.n_bins * self.width)
        self.incident = [
            dr.zeros(mi.Int64, n_batches)
            for _ in range(0 if bench.beam.uniform else self.channels)
        ]

    def add(self, bins, exits, active, batch):
        """Scatter one ray per lane, each for its `batch`."""
        direct = exits.fate == mi.UInt32(Fate.DIRECT)
        if self.deposits:
            bins = self.bench.fate_bins(bins, direct)
        self.deposit(bins, exits.throughput, active, batch)
        if self.bench.specimen.periodic and not self.deposits:
            twice = active & direct & (bins < self.bench.n_collected)
            bins = mi.UInt32(self.bench.n_collected + Fate.DIRECT)
            self.deposit(bins, exits.throughput, twice, batch)
        for target, power in zip(
            self.incident, _fixed_point(exits.incident, self.scale)
        ):
            _scatter_add(target, power, batch, active)

    def deposit(self, bins, power, active, batch):
        """Scatter a power per lane to a patch or to DIRECT, or one lane to its fate."""
        powers = _fixed_point(power, self.scale)
        collected = bins < self.bench.n_collected
        collected |= bins == self.bench.n_collected + Fate.DIRECT
        excesses = [powers[0] - self.scale, *(p - powers[0] for p in powers[1:])]
        packet = [1, *(dr.select(collected, e, 0) for e in excesses)]
        packet += [0] * (self.width - len(packet))
        bins = bins + batch * self.bench.n_bins
        _scatter_add(self.bins, mi.ArrayXi64(packet), bins, active)

    def tally(self, n_batches):
        """Run the kernel and return the :class:`Tally` of the first `n_batches`.

        A beam of uniform power needs no sum of it: every ray that met the specimen
        carried the power 1.
        """
        dr.eval(self.bins, self.incident)
        bench, scale = self.bench, self.scale
        bins = self.bins.numpy().reshape(self.n_batches, bench.n_bins, self.width)
        bins = bins[:n_batches, :, : 1 + self.channels]
        patches, fates = np.split(bins, [bench.n_collected], axis=1)
        sums = _flux(patches, scale).reshape(n_batches, *bench.shape, -1)
        direct = _flux(fates[:, Fate.DIRECT], scale)
        hits = patches[..., 0].astype(np.uint64).reshape(n_batches, *bench.shape)
        fates = fates[..., 0].astype(np.uint64)
        if not self.deposits:
            fates[:, Fate.REFLECTED] = hits[:, 0].sum(axis=(1, 2))
        if bench.shape[0] == 2 and not self.deposits:
            scattered = hits[:, 1].sum(axis=(1, 2)) - fates[:, Fate.DIRECT]
            fates[:, Fate.TRANSMITTED] = scattered
        if self.incident:
            power = np.stack([total.numpy() for total in self.incident], axis=-1)
            power = power[:n_batches].astype(np.uint64)
        else:
            met = fates.sum(axis=1) - fates[:, Fate.MISSED] - fates[:, Fate.UNLIT]
            power = np.repeat(met[:, None] * np.uint64(scale), self.channels, axis=1)
        return Tally(hits.sum(axis=0), sums, power, fates, scale, direct=direct)


def _flux(bins, scale):
    """Flux per channel of bins of hits and excesses, in units of ``1 / scale``."""
    flux = bins[..., 1:].copy()
    flux[..., 0] += bins[..., 0] * scale
    flux[..., 1:] += flux[..., :1]
    return flux.astype(np.uint64)


def packet_width():
    """Numbers of a bin, a power of two: hits and all channels."""
    return 1 << len(mi.Spectrum()).bit_length()


def _scatter_add(target, value, index, active):
    """Add to the sums, in the kernel that is being traced."""
    dr.scatter_reduce(dr.ReduceOp.Add, target, value, index, active)


def _fixed_point(powers, scale):
    """Powers of all channels as whole numbers of ``1 / scale`` of a ray.

    By 32-bit integers, to which vector units convert much faster: whole rays, which
    stay below LARGEST_POWER, and the rest.
    """

    def _whole(x):
        return mi.Int64(mi.Int32(x))

    if scale == 1:
        return [_whole(dr.round(power)) for power in powers]
    return [
        _whole(dr.floor(power)) * scale
        + _whole(dr.round((power - dr.floor(power)) * float(scale)))
        for power in powers
    ]
