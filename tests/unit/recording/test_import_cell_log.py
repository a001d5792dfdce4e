"""A bus log of a whole measurement, written by python-can, to the model behind it."""

from __future__ import annotations

import re

from invid.cli.app import run


def frames(n: int) -> list[str]:
    lines = []
    for k in range(n):
        lines.append(f"({1.7e9 + 0.01 * k:.6f}) can0 080#")
        data = (10 * k).to_bytes(4, "little") + (k % 900).to_bytes(2, "little") + b"\x37\x06"
        lines.append(f"({1.7e9 + 0.01 * k + 1e-3:.6f}) can0 185#{data.hex().upper()}")
        lines.append(f"({1.7e9 + 0.01 * k + 2e-3:.6f}) can0 205#0F000A00")
    return lines


def test_a_log_without_sync_or_pdos_is_refused_with_the_identifiers_it_has(tmp_path, capsys):
    log = tmp_path / "c.log"
    bare = [line for line in frames(50) if " 080#" not in line]
    log.write_text("\n".join(bare) + "\n", encoding="utf-8")
    assert run(["import", "--suggest", str(log)]) == 0
    assert "no SYNC" in capsys.readouterr().out
    log.write_text(
        "\n".join(re.sub(r" [0-9A-F]{3}#", " 705#", line) for line in bare) + "\n", encoding="utf-8"
    )
    assert run(["import", "--suggest", str(log)]) == 2
    assert "0x705" in capsys.readouterr().err
