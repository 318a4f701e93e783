"""Total variation distance of a prediction from a measurement, and its noise."""

from __future__ import annotations

import numpy as np

from ..array_types import Floats
from .campaign_outcome import PredictionError
from .planning import lobe
from .record import Record
from .tally import Integrals, Tally

# Standard errors of a patch that are noise, not an error of what predicts it: of a
# thousand patches the worst has some three.
N_STD_ERRS = 3


def prediction_error(record: Record, predicted: Floats) -> PredictionError:
    r"""How far a prediction is from a record of one incident direction.

    The sum of absolute differences from a noisy record is too large: noise adds to it
    wherever the difference is small. Therefore the sign of each patch's difference is
    taken from all batches but one, and its size from that one, in turn (cross-fitting;
    Chernozhukov et al. 2018, doi:10.1111/ectj.12097): the expected value of

    .. math::

        \frac{1}{2 \Phi} \sum_p s_p(\text{others}) (m_p(\text{one}) - \hat m_p)

    is never above the truth, 0 where there is no difference, and below the truth by no
    more than half of what noise would add. Its scatter over the batches, by their
    number's root, is the standard error; batches share most signs, so that where there
    is no difference this is too small, by about 1.7 for independent rays. Integrals
    have no noise; what they may be wrong by is the standard error.

    Parameters
    ----------
    record : Record
    predicted : ndarray, shape (n_hemispheres, n_theta, n_phi, channels)
        Flux fractions.
    """
    (tally,) = record.tallies
    flux = record.flux_fraction[0] if record.stacked else record.flux_fraction
    # one channel may stand for several
    flux, predicted = np.broadcast_arrays(flux, predicted)
    total = flux.sum()
    difference = predicted - flux
    if not total > 0:
        distance, std_err, total = float(np.abs(difference).sum() / 2 > 0), 0.0, 1.0
    elif isinstance(tally, Integrals) or tally.n_batches < 2:
        distance = np.abs(difference).sum() / 2 / total
        std_err = _stated_error(record) / total
    else:
        each = _cross_fitted(tally, predicted) / total
        distance, std_err = each.mean(), each.std(ddof=1) / np.sqrt(len(each))
    totals = difference.sum(axis=(1, 2, 3)) / total
    dhr, dht = (*totals, 0.0)[:2]
    angles = record.theta_i[0], record.phi_i[0]
    relative = _relative_error(record, flux, predicted)
    numbers = *angles, distance, std_err, dhr, dht, relative
    return PredictionError(*map(float, numbers))


def _relative_error(record: Record, flux: Floats, predicted: Floats) -> float:
    """Largest relative error of a patch worth reporting, beyond its noise."""
    areas = record.subdivision.projected_solid_angles
    each = [np.reshape(record.brdf_std_err, (*areas.shape, -1))]
    if record.btdf_std_err is not None:
        each.append(np.reshape(record.btdf_std_err, (*areas.shape, -1)))
    noise = N_STD_ERRS * np.stack(each) * areas[..., None]
    bright = [lobe(one / areas, areas) for one in np.moveaxis(flux, -1, 0)]
    excess = np.abs(predicted - flux) - np.broadcast_to(noise, flux.shape)
    relative = excess / np.where(flux > 0, flux, 1)
    return float(np.nanmax(relative[np.stack(bright, axis=-1)], initial=0))


def expected_noise(record: Record) -> float:
    """Total variation distance that a record's standard errors make on average.

    Of one incident direction, as a fraction of the flux that leaves; the errors of
    patches are taken as normal. 0 where all batches agree, as on a mirror, or nothing
    left at all; infinite where no error is known, of a single batch.
    """
    total = record.flux_fraction.sum()
    if record.n_batches < 2:
        return float(np.inf)
    noise = np.sqrt(2 / np.pi) * _stated_error(record) / total if total > 0 else 0.0
    return float(noise)


def _stated_error(record: Record) -> float:
    """Half the sum of what flux fractions are wrong by on average."""
    (one,) = record.estimates
    hemispheres = range(record.n_hemispheres)
    return float(
        sum(np.nansum(one.patches(number).noise) for number in hemispheres) / 2
    )


def _cross_fitted(tally: Tally, predicted: Floats) -> Floats:
    """Half the sum of differences, batch by batch, with the signs of the others."""
    incident = tally.incident[:, None, None, None, :].astype(float)
    sums, all_sums = tally.sums.astype(float), tally.sums.sum(axis=0, dtype=float)
    found = []
    for own, power in zip(sums, incident):
        others = (all_sums - own) / (incident.sum(axis=0) - power)
        signs = np.sign(predicted - others)
        found.append((signs * (predicted - own / power)).sum() / 2)
    return np.array(found)
