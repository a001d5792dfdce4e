"""How late the SYNCs were: a histogram of fixed size, however long the run."""

from __future__ import annotations

BUCKETS = 24
"""Powers of two in microseconds: the last one is eight seconds."""


class Jitter:
    """Histogram of how late SYNC was against its slot."""

    def __init__(self) -> None:
        self.counts = [0] * BUCKETS
        self.worst_s = 0.0

    def add(self, seconds: float) -> None:
        """Count the lateness of one SYNC."""
        if seconds > self.worst_s:
            self.worst_s = seconds
        bucket = int(seconds * 1e6).bit_length() if seconds > 0 else 0
        self.counts[bucket if bucket < BUCKETS else BUCKETS - 1] += 1

    def percentiles(self) -> dict[str, float]:
        """Upper bounds [µs] from the buckets, and the worst."""
        total = sum(self.counts)
        found = {}
        for name, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999)):
            seen = 0
            for bucket, count in enumerate(self.counts):
                seen += count
                if total and seen >= share * total:
                    found[name] = min(float(1 << bucket), self.worst_s * 1e6)
                    break
        found["worst"] = self.worst_s * 1e6
        return found

    def to_json(self) -> dict[str, int]:
        """Counts by their upper bound."""
        return {f"{1 << b} us": n for b, n in enumerate(self.counts) if n}
