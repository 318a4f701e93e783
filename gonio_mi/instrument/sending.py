"""Sending all rays of a measurement, with a progress bar and an ear for Ctrl-C."""

from collections.abc import Sequence

from ..progress import bar
from ..results.tally import Tally
from ..transport.bench import Bench
from .batches import Target, rays_sent, send, send_until
from .instrument import Instrument

__all__ = ["send_all"]

# Incident directions whose integrals are found together: what Ctrl-C may cost.
TOGETHER = 64


def send_all(
    instrument: Instrument,
    benches: Sequence[Bench],
    keys: Sequence[tuple[int, ...]],
    plan: Sequence[int],
    target: Target | None,
    finished: list[list[Tally]],
    progress: bool = False,
) -> bool:
    """Complete the tallies of all benches in `finished`; return whether they are.

    After Ctrl-C they are those of what was finished; it is raised if that is nothing.
    """
    sent_before = [sum(rays_sent(some, instrument.passes)) for some in finished]
    left = len(benches) * sum(plan) - sum(sent_before)
    rays = None if target else left * instrument.passes
    waiting: list[tuple[Bench, list[Tally], list[Tally]]] = []
    with bar(
        progress, total=rays, unit="ray", unit_scale=True, delay=1, mininterval=0.2
    ) as report:
        try:
            for bench, key, tallies in zip(benches, keys, finished):
                # without the integrals beside them rays are not enough
                sent = [] if instrument.integrates else tallies
                if not instrument.samples(bench):
                    if report is not None:
                        report(sum(plan))
                elif target:
                    send_until(target, instrument, bench, key, sent, report)
                else:
                    send(instrument, bench, key, plan, sent, report)
                if instrument.integrates:
                    waiting.append((bench, sent, tallies))
                if len(waiting) == TOGETHER:
                    _integrate(instrument, waiting)
            _integrate(instrument, waiting)
        except (KeyboardInterrupt, RuntimeError) as error:
            if not _is_ctrl_c(error):
                raise
            if not any(finished):
                raise KeyboardInterrupt from None
            return False
    return True


def _integrate(
    instrument: Instrument, waiting: list[tuple[Bench, list[Tally], list[Tally]]]
) -> None:
    """Finish the directions that wait for their integrals, which they share."""
    if waiting:
        benches, sent, tallies = zip(*waiting)
        for kept, integrals in zip(tallies, instrument.integrated(benches, sent)):
            kept[:] = [integrals]
        waiting.clear()


def _is_ctrl_c(error: BaseException | None) -> bool:
    """Whether Ctrl-C is at the bottom of it: Dr.Jit wraps what a loop raises."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
