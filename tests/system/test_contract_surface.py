"""What the contract promises of a result that cannot be trusted, seen from the command line alone."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

RATE, PERIOD, PERIODS = 500.0, 2048, 4


def write_recording(path: Path, lines: np.ndarray, peak: float, torque_noise: float) -> None:
    """A free two-mass axis (2 and 1.5 kg·m², 900 N·m/rad) shaken at ``lines``, with white noise."""
    rng = np.random.default_rng(1)
    omega = 2 * np.pi * lines * RATE / PERIOD
    far = 900 + 0.5j * omega
    stiffness = far - 2 * omega**2 - far**2 / (far - 1.5 * omega**2)
    spectrum = np.exp(2j * np.pi * rng.random(lines.size))
    torque_bins = np.zeros(PERIOD // 2 + 1, complex)
    position_bins = torque_bins.copy()
    torque_bins[lines], position_bins[lines] = spectrum, spectrum / stiffness
    torque = np.fft.irfft(torque_bins)
    scale = peak / np.abs(torque).max()
    torque = np.tile(torque * scale, PERIODS)
    position = np.tile(np.fft.irfft(position_bins) * scale, PERIODS)
    torque = torque + torque_noise * rng.standard_normal(torque.size)
    position = position + 1e-6 * rng.standard_normal(position.size)
    with h5py.File(path, "w") as f:
        f.attrs.update(
            format="invid-recording",
            format_version=1,
            created="2026-11-21T10:00:00Z",
            robot="stranger",
            axes=json.dumps(["J1"]),
            position_unit="rad",
            torque_unit="N·m",
        )
        group = f.create_group("experiments/000")
        group.attrs.update(
            kind="multisine",
            excited_axis=0,
            role="identify",
            hold_gain=[0.0],
            period_samples=PERIOD,
            frequencies_hz=lines * RATE / PERIOD,
            sample_rate_hz=RATE,
        )
        group["time"] = np.arange(torque.size) / RATE
        group["position"] = position[:, None]
        group["torque"] = torque[:, None]


def identify(*arguments: str) -> tuple[int, dict[str, Any], str]:
    """Exit status, the one document on stdout (NaN refused) and stderr."""
    done = subprocess.run(
        [str(Path(sys.executable).with_name("invid")), "identify", *arguments, "--json"],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )

    def refuse(word: str) -> float:
        raise ValueError(f"{word} is no JSON")

    assert "Traceback" not in done.stderr
    return done.returncode, json.loads(done.stdout, parse_constant=refuse), done.stderr


@pytest.mark.parametrize(
    ("lines", "peak", "noise", "word"),
    [
        (np.array([1, 3]), 5.0, 0.01, "unknowns"),
        (np.arange(1, 100, 2), 1e-6, 50.0, "too weak"),
    ],
    ids=["two lines only", "excitation below the noise"],
)
def test_data_that_carry_no_model_exit_3_with_the_reason_among_the_warnings(
    lines: np.ndarray, peak: float, noise: float, word: str, tmp_path: Path
) -> None:
    recording, kept = tmp_path / "rec.h5", tmp_path / "model.json"
    write_recording(recording, lines, peak, noise)
    kept.write_text("kept")
    status, document, stderr = identify(str(recording), "--masses", "2", "-o", str(kept))
    assert status == 3
    assert document["format"] == "invid-model"
    assert document["branches"] == []
    assert any(word in w for w in document["warnings"])
    assert word in stderr
    assert kept.read_text() == "kept"


def test_the_same_record_well_excited_gives_the_masses_and_the_spring(tmp_path: Path) -> None:
    recording = tmp_path / "rec.h5"
    write_recording(recording, np.arange(1, 100, 2), 5.0, 0.01)
    status, document, _ = identify(str(recording), "--masses", "2")
    assert status == 0
    branch = document["branches"][0]
    found = [e["value"] for e in (*branch["masses"], *branch["springs"])]
    assert found == pytest.approx([2.0, 1.5, 900.0], rel=0.02)
