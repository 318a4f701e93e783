"""What a ratio that should be 1 looks like: a cosine, a Jacobian, a probability."""

import numpy as np

__all__ = ["FACTORS", "explain_ratio", "factor"]

# What is likely forgotten, or there once too often, and how it reads.
FACTORS = {
    "cos_o": "the cosine of wo",
    "cos_i": "the cosine of wi",
    "sin_o": "the sine of theta_o",
    "pi": "a factor pi",
    "four": "a factor 4",
    "two": "a factor 2",
    "jacobian": "the Jacobian of the half vector, 1 / (4 wo.h)",
    "dot": "wo.h",
    "cos_h": "the cosine of the half vector",
    "eta2": "eta^2",
    "component": "the probability of the lobe",
    "pdf": "`pdf`",
}

# How near to 1 a ratio must be, for nine samples in ten, to be explained.
NEAR = 2e-3


def factor(name, drawn, mask):
    """Values of a factor for some samples."""
    wi, wo = drawn.condition.wi, drawn.wo[mask]
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    if name == "cos_o":
        return np.abs(wo[:, 2])
    if name == "cos_i":
        return np.full(len(wo), abs(wi[2]))
    if name == "sin_o":
        return np.maximum(np.hypot(wo[:, 0], wo[:, 1]), 1e-9)
    if name == "jacobian":
        return 1 / (4 * np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6))
    if name == "dot":
        return np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6)
    if name == "cos_h":
        return np.maximum(np.abs(half[:, 2]), 1e-9)
    if name == "eta2":
        return drawn.eta[mask] ** 2
    if name == "component":
        shares = np.bincount(drawn.component[drawn.smooth].astype(int))
        return (shares / shares.sum())[drawn.component[mask].astype(int)]
    if name == "pdf":
        return drawn.pdf[mask]
    return np.full(len(wo), {"pi": np.pi, "four": 4.0, "two": 2.0}[name])


def explain_ratio(cases, function, what):
    """Sentence on a ratio of two answers that should be 1.

    Parameters
    ----------
    cases : list of (ndarray, Drawn, mask)
        Ratios, the samples, and which of them the ratios are of.
    function : str
        Where the ratio's numerator comes from.
    what : str
        The ratio, in words.
    """
    # the worst half tells most; where all is right nothing can be told
    cases = [c for c in cases if not _is_near(c[0])] or cases
    if not cases:
        return f"`{function}` contradicts the other functions"
    for name, text in FACTORS.items():
        if _trivial(name, cases):
            continue
        for power, words in ((1, "has {} too much"), (-1, "lacks {}")):
            # probabilities are known from frequencies only
            near = 0.02 if name == "component" else NEAR
            if all(
                _is_near(ratio / factor(name, drawn, mask) ** power, near)
                for ratio, drawn, mask in cases
            ):
                return _worded(function, name, power, words.format(text), drawn=cases)
    ratios = np.concatenate([ratio for ratio, _, _ in cases])
    low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
    if high - low < NEAR * middle:
        return f"`{function}`: {what} is {middle:.4g} everywhere"
    return f"`{function}`: {what} is {low:.4g} to {high:.4g}, median {middle:.4g}"


def _worded(function, name, power, words, drawn):
    modes = {case[1].condition.mode for case in drawn}
    mode = f" in {modes.pop()} mode" if name == "eta2" and len(modes) == 1 else ""
    if function == "sample" and name in ("component", "pdf"):
        # weight times pdf has a factor too little: it was never divided by it
        verb = "is divided by {} once more" if power < 0 else "lacks division by {}"
        return "`sample` weight " + verb.format(FACTORS[name])
    return f"`{function}` {words}{mode}"


def _trivial(name, cases):
    """Whether a factor is 1 for all samples, or cannot be told from a constant."""
    values = [factor(name, drawn, mask) for _, drawn, mask in cases]
    if name in ("pi", "four", "two"):
        return False
    return all(np.ptp(v) < 1e-6 for v in values) and name in ("component", "cos_h")


def _is_near(ratio, near=NEAR):
    low, high = np.quantile(ratio, [0.05, 0.95])
    return low > 1 - near and high < 1 + near
