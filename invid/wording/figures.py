"""Numbers as a person reads them: as many digits as their uncertainty leaves."""

from __future__ import annotations

import math


def differing_number(value: float, std: float) -> str:
    """Return a number with as many decimals as its standard deviation has meaning (one digit of it)."""
    if not (std > 0 and math.isfinite(std)):
        return f"{value:.6g}"
    first = math.floor(math.log10(std))
    if std / 10**first >= 9.5:  # would round up into the next decade
        first += 1
    decimals = max(0, -first)
    if decimals > 12 or abs(value) >= 1e9:
        return f"{value:.6g}"
    return f"{value:.{decimals}f}"


def percent(fraction: float) -> str:
    """Return a bound in per cent, two digits; "any size" where it says nothing."""
    value = 100 * fraction
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %" if value < 1e4 else "any size"


def explained_percent(fraction: float) -> str:
    """Return an explained share, rounded down: 100 % is said of all alone."""
    return f"{math.floor(1000 * min(fraction, 1.0) + 1e-9) / 10:.1f} %"


def signed(difference: float, std: float) -> str:
    """Return "+1.31 ± 0.02" of a difference and its standard deviation."""
    sign = "+" if difference >= 0 else "−"
    return f"{sign}{differing_number(abs(difference), std)} ± {differing_number(std, std)}"


def signed_share(difference: float, of: float) -> str:
    """Return "+22 %" of a difference; empty where the share says nothing."""
    share = abs(100 * difference / of) if of else math.inf
    if not share < 1000:
        return ""
    return f"{'+' if difference >= 0 else '−'}{f'{share:.2g}' if share < 99.5 else f'{share:.0f}'} %"
