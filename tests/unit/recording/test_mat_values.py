"""MAT files as MATLAB and Simulink write them: structs with time, cells, struct arrays, and objects."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.import_source import suggest_map
from invid.recording.readers.kinds import read_table

N = 500
TIME = np.arange(N) * 2e-3
ANGLE = np.sin(9 * TIME) * (1 + TIME)
TORQUE = 3 * np.cos(9 * TIME) * (1 + TIME)


def structs(*entries: dict) -> np.ndarray:
    out = np.empty((1, len(entries)), dtype=[(k, object) for k in entries[0]])
    for i, entry in enumerate(entries):
        for key, value in entry.items():
            out[key][0, i] = value
    return out


def written_by_matlab(path: Path) -> None:
    """The header that MATLAB writes before the HDF5 signature."""
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def columns_of(axis: dict) -> tuple[str, str]:
    return axis["position"]["column"], axis["torque"]["column"]


def test_scope_data_of_several_signals_go_by_their_labels(tmp_path):
    signals = structs(
        {"values": np.c_[TORQUE], "label": "<drive torque>"}, {"values": np.c_[ANGLE], "label": "angle"}
    )
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"out": structs({"time": np.c_[TIME], "signals": signals})})
    table = read_table(path, Source())
    np.testing.assert_array_equal(table.column("out.signals[1].values"), ANGLE)
    np.testing.assert_array_equal(table.column("out.signals.values[0]"), TORQUE)
    found = suggest_map([path], None)[1].document
    assert found["time"] == {"column": "out.time", "unit": "s"}
    assert columns_of(found["axes"][0]) == (
        "out.signals.angle.values",
        "out.signals.<drive torque>.values",
    )


def test_cells_and_struct_arrays_of_v73_are_read_through_their_references(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        refs = file.create_group("#refs#")
        kinds = {"values": [TORQUE, ANGLE], "label": ["tau", "theta"]}
        for key, values in kinds.items():
            for i, value in enumerate(values):
                data = (
                    np.array([[ord(c)] for c in value], np.uint16) if isinstance(value, str) else value[None]
                )
                made = refs.create_dataset(f"{key}{i}", data=data)
                made.attrs["MATLAB_class"] = np.bytes_("char" if isinstance(value, str) else "double")
        for name in ("scope/signals",):
            group = file.create_group(name)
            for key in kinds:
                stored = group.create_dataset(key, (2, 1), h5py.ref_dtype)
                for i in range(2):
                    stored[i, 0] = refs[f"{key}{i}"].ref
        file["scope/time"] = TIME[None]
        cell = file.create_dataset("cells", (1, 2), h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        cell[0, 0], cell[0, 1] = refs["values0"].ref, refs["values1"].ref
    written_by_matlab(path)
    table = read_table(path, Source())
    np.testing.assert_array_equal(table.column("scope.signals.theta.values"), ANGLE)
    np.testing.assert_array_equal(table.column("scope.signals[0].values"), TORQUE)
    np.testing.assert_array_equal(table.column("cells[1]"), ANGLE)
    assert table.clocks["scope.signals.tau.values"] == "scope.time"


@pytest.mark.parametrize("kind", ["timeseries", "timetable", "Simulink.SimulationData.Dataset"])
@pytest.mark.parametrize("beside", [False, True])
def test_an_object_of_v73_is_refused_by_name_and_its_handle_is_no_data(tmp_path, kind, beside):
    path = Path(tmp_path / "a.mat")
    with h5py.File(path, "w", userblock_size=512) as file:
        handle = np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32).T
        made = file.create_dataset("torque", data=handle)
        made.attrs["MATLAB_class"] = np.bytes_(kind)
        made.attrs["MATLAB_object_decode"] = np.int32(3)
        if beside:
            file["q"], file["t"] = ANGLE[None], TIME[None]
    written_by_matlab(path)
    if beside:
        table = read_table(path, Source())
        assert set(table.columns) == {"q", "t"}
        assert any(f"class {kind}" in r for r in table.reasons)
    else:
        with pytest.raises(InputError, match=f"class {kind}, which only MATLAB reads"):
            read_table(path, Source())
