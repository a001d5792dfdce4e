"""Adapters that are not there: one sentence each, whatever python-can's interface raises."""

import tomllib
from ctypes.util import find_library
from pathlib import Path

import can
import pytest

from invid.config.schema import BusConfig
from invid.errors import BusError, ConfigError
from invid_drivers.adapters import NEEDS, open_adapter

ROOT = Path(__file__).parents[3]
CHANNELS = ("0", "can0", "PCAN_USBBUS1", "/dev/ttyACM9")
OPEN_HERE = {"virtual", "udp_multicast"}
"""Need nothing of the machine."""


@pytest.mark.parametrize("interface", sorted(can.VALID_INTERFACES))
@pytest.mark.parametrize("channel", CHANNELS)
def test_every_interface_of_python_can_opens_or_is_one_sentence_with_the_way_out(
    interface: str, channel: str, capfd: pytest.CaptureFixture[str]
) -> None:
    try:
        bus = open_adapter(BusConfig(interface=interface, channel=channel))
    except (BusError, ConfigError) as error:
        said = str(error)
        assert said.startswith(f"bus {interface} {channel}: ")
        assert "\n" not in said
        assert "install" in said or "check" in said
    else:
        bus.shutdown()
        assert interface in OPEN_HERE
    out, err = capfd.readouterr()
    assert out == ""
    assert "Traceback" not in err


@pytest.mark.skipif(find_library("canlib") is not None, reason="Kvaser's CANlib is installed here")
def test_kvaser_without_canlib_is_a_bus_that_failed_and_names_the_library() -> None:
    with pytest.raises(BusError, match=r"kvaser 0: the driver of this interface is not there.*CANlib"):
        open_adapter(BusConfig(interface="kvaser", channel="0"))


def test_every_extra_that_a_sentence_names_is_one_of_the_package() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {text.split("invid[")[1].split("]")[0] for text in NEEDS.values() if "invid[" in text}
    assert named <= set(extras["optional-dependencies"])
    assert {"slcan", "gs-usb"} <= named
