"""Records built by hand from whole numbers, without a renderer."""

import zipfile
from dataclasses import replace

import numpy as np

from gonio_mi.collector import subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.files import checks
from gonio_mi.results.provenance import Provenance
from gonio_mi.results.record import Record
from gonio_mi.results.tally import WEIGHT_SCALE, Fate, Integrals, Tally
from gonio_mi.settings import MeasurementSettings


def specular(patches, theta_deg, phi_deg, power):
    """Lambertian plus a Phong-like lobe around a direction: weights of the patches."""
    theta, phi = patches.middles
    to_theta, to_phi = np.radians([theta_deg, phi_deg])
    cosine = np.cos(theta) * np.cos(to_theta)
    cosine += np.sin(theta) * np.sin(to_theta) * np.cos(phi - to_phi)
    lobe = np.fmax(cosine, 0) ** power  # none outside of apertures
    weight = (0.02 + lobe) * patches.projected_solid_angles
    return weight / weight.sum()


def tally(patches, weights, rays, rng, channels=1, n_batches=4, analog=False):
    """Tally of multinomial counts; `weights` per hemisphere, the rest is absorbed."""
    chances = np.append(np.ravel(weights), 1 - np.sum(weights))
    counts = rng.multinomial(rays, chances / chances.sum(), size=n_batches)
    shape = (n_batches, len(weights), *patches.shape)
    received = counts[:, :-1].reshape(shape).astype(np.uint64)
    fates = np.zeros((n_batches, len(Fate)), np.uint64)
    for row, hemisphere in zip((Fate.REFLECTED, Fate.TRANSMITTED), range(len(weights))):
        fates[:, row] = received[:, hemisphere].sum(axis=(1, 2))
    fates[:, Fate.ABSORBED] = counts[:, -1]
    scale = 1 if analog else WEIGHT_SCALE
    tint = np.linspace(1, 0.25, channels) * scale
    return Tally(
        hits=received.sum(axis=0, dtype=np.uint64),
        sums=(received[..., None] * tint).astype(np.uint64),
        incident=np.full((n_batches, channels), rays * scale, np.uint64),
        fates=fates,
        scale=scale,
    )


def writeable(tally):
    """Copy of a record's tally, to be filled in for another record."""
    copies = {name: getattr(tally, name).copy() for name in tally.arrays}
    return replace(tally, **copies)


def record(
    collector="projected:6x8",
    theta_i=(30.0,),
    phi_i=(20.0,),
    channels=("Y",),
    both=False,
    rays=20_000,
    n_batches=4,
    power=30,
    analog=False,
    stacked=None,
    seed=1,
):
    """Record of a glossy specimen, and of a diffusing transmitter if `both`."""
    patches = subdivision(collector)
    rng = np.random.default_rng(seed)
    tallies = []
    for theta, phi in zip(theta_i, phi_i):
        mirror = np.nan_to_num(theta), np.nan_to_num(phi) + 180
        weights = [0.6 * specular(patches, *mirror, power)]
        if both:
            weights.append(0.3 * specular(patches, *mirror, 1))
        tallies.append(
            tally(
                patches, np.array(weights), rays, rng, len(channels), n_batches, analog
            )
        )
    return Record(
        subdivision=patches,
        theta_i=np.array(theta_i, dtype=float),
        phi_i=np.array(phi_i, dtype=float),
        channels=tuple(channels),
        tallies=tuple(tallies),
        asked=MeasurementSettings(
            estimator="analog" if analog else "weighted", footprint=0.1
        ),
        provenance=Provenance(
            specimen="synthetic gloss",
            sampler="independent",
            seeds=(seed,),
            rays=rays * n_batches,
            versions={"gonio_mi": "0.1.0", "numpy": "2.4"},
        ),
        stacked=len(theta_i) > 1 if stacked is None else stacked,
    )


def lambertian(reflectance=0.5, theta_i=(0.0, 30.0, 60.0), collector="projected:9x16"):
    """Record of a Lambertian to the rounding of its whole numbers."""
    patches = subdivision(collector)
    base = record(collector, theta_i=theta_i, phi_i=(0.0,) * len(theta_i), n_batches=2)
    share = patches.projected_solid_angles * (reflectance / np.pi)
    tallies = [writeable(tally) for tally in base.tallies]
    for tally in tallies:
        one = np.round(share * tally.incident[0, 0]).astype(np.uint64)
        tally.sums[:] = one[None, None, ..., None]
    return replace(base, tallies=tuple(tallies))


def exact(weights, theta_i, collector, phi_i=0.0):
    """Record of given flux fractions, shape ``(n, hemispheres, rings, sectors)``."""
    patches = subdivision(collector)
    tallies = []
    for per_hemisphere in weights:
        sums = np.round(np.asarray(per_hemisphere) * 2**40).astype(np.uint64)
        hits = (sums > 0).astype(np.uint64)  # a ray in each patch that light reaches
        fates = np.zeros((1, len(Fate)), np.uint64)
        for fate, received in zip((Fate.REFLECTED, Fate.TRANSMITTED), hits):
            fates[0, fate] = received.sum()
        fates[0, Fate.ABSORBED] = 1  # and one that none of them received
        tallies.append(
            Tally(
                hits=hits,
                sums=sums[None, ..., None],
                incident=np.array([[2**40]], np.uint64),
                fates=fates,
                scale=WEIGHT_SCALE,
            )
        )
    return Record(
        subdivision=patches,
        theta_i=np.array(theta_i, float),
        phi_i=np.broadcast_to(np.asarray(phi_i, float), len(theta_i)),
        channels=("Y",),
        tallies=tuple(tallies),
        stacked=True,
    )


def facets(wo, theta_i, phi_i, widths, tilt=(0.0, 0.0), turn=0.0):
    """BRDF of single reflections at Gaussian slopes, all of them seen and lit.

    Around a mean slope, on a surface that is turned; all angles in degrees.
    """
    wi = direction(np.radians(theta_i), np.radians(phi_i))
    half = wo + wi
    slopes = half[..., :2] / half[..., 2:] - np.asarray(tilt)
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    slopes = slopes @ np.array([[cos, -sin], [sin, cos]]) / widths
    norm = np.linalg.norm(half, axis=-1)
    density = np.exp(-np.sum(slopes**2, axis=-1) / 2) * (norm / half[..., 2]) ** 3
    return density / (half @ wi / norm) / wo[..., 2]


def facets_through(wo, theta_i, phi_i, widths, eta):
    """BTDF of single refractions at such slopes; `wo` as seen from above."""
    wi, out = direction(np.radians(theta_i), np.radians(phi_i)), wo * [1, 1, -1]
    half = (wi + eta * out) * np.sign(1 - eta)
    normal = half / np.linalg.norm(half, axis=-1, keepdims=True)
    comes, goes = normal @ wi, -np.sum(normal * out, axis=-1)
    up = normal[..., 2]
    seen = (comes > 0) & (goes > 0) & (up > 0)
    slopes = normal[..., :2] / np.where(seen, up, 1)[..., None] / widths
    density = np.exp(-np.sum(slopes**2, axis=-1) / 2) / np.where(seen, up, 1) ** 4
    # all normals refract as much: Walter et al. 2007, equation 17 is left
    value = density * goes / (comes - eta * goes) ** 2 / wo[..., 2]
    return np.where(seen, value, 0)


def facet_lobes(patches, incidents, widths=(0.1, 0.2), of=facets, **more):
    """Flux fractions, half of the light each, by 16 x 16 points of each patch."""
    points = patches.points(16)
    flux = [of(points, *one, widths, **more).mean(axis=1) for one in incidents]
    flux = np.reshape(flux, (-1, *patches.shape)) * patches.projected_solid_angles
    return flux / flux.sum(axis=(1, 2), keepdims=True) / 2


def huge():
    """Record whose numbers need more than 32 bits, up to 64."""
    small = record(channels=("R", "G", "B"), both=True)
    one = small.tallies[0]
    sums = one.sums * np.uint64(2**20)
    sums[0, 0, 0, 0] = [2**63 + 1, 2**32, 2**32 - 1]
    hits = one.hits + np.uint64(2**32)
    fates = one.fates.copy()
    rows = [Fate.REFLECTED, Fate.TRANSMITTED]
    fates[0, rows] += np.uint64(small.subdivision.n_patches * 2**32)
    incident = one.incident * np.uint64(2**20)
    big = Tally(hits, sums, incident, fates, one.scale)
    return Record(
        small.subdivision,
        small.theta_i,
        small.phi_i,
        small.channels,
        (big,),
        small.asked,
        replace(small.provenance, rays=int(fates.sum())),
    )


def telling(record, **settings):
    """The record, of which files say these settings, whether they can be or not."""
    told = replace(record)
    told.__dict__["settings"] = {**record.settings, **settings}
    return told


def integrals(value=0.01):
    """Record of integrals, of the same flux fraction in each patch: no ray was sent."""
    made = record()
    patches = made.subdivision
    flux = np.full((1, *patches.shape, 1), value)
    nothing = Tally.empty(1, patches.shape, 1, WEIGHT_SCALE)
    found = replace(made, tallies=(Integrals.beside(nothing, flux, 1e-7 * flux),))
    return found.with_settings(estimator="quadrature", rel_err=1e-4)


def seal_again(path):
    """Put the check sum after a file that was changed by hand, as gonio-mi does."""
    data = path.read_bytes()
    if checks.SEAL_MARK in data:
        data = data[: -checks.SEAL_LENGTH]
    elif path.suffix == ".npz":
        with zipfile.ZipFile(path, "a") as archive:
            archive.comment = bytes(checks.SEAL_LENGTH)
        data = path.read_bytes()[: -checks.SEAL_LENGTH]
    path.write_bytes(data + checks.seal_of(data))
