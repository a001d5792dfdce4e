"""Open a CAN adapter through python-can; whatever its driver raises becomes one sentence with the way out."""

from __future__ import annotations

import logging

import can

from invid.config.schema import BusConfig
from invid.errors import BusError, ConfigError
from invid.wording.sentence import sentence

logging.getLogger("can").addHandler(logging.NullHandler())
"""What python-can logs while it looks for libraries is in the error; else Python would print it as well."""
_WINDOWS = "its driver is made for Windows only; on Linux bring the adapter up as a SocketCAN interface"
NEEDS = {
    "canalystii": "install it with: pip install 'invid[canalystii]'",
    "cantact": "install it with: pip install 'invid[cantact]'",
    "etas": f"install ETAS BOA; {_WINDOWS}",
    "gs_usb": "install it with: pip install 'invid[gs-usb]', and libusb with the system's packages; or use "
    "the kernel's own driver with interface socketcan",
    "iscan": "install the vendor's iscandrv library",
    "ixxat": f"install IXXAT VCI 4; {_WINDOWS}",
    "kvaser": "install Kvaser's CANlib (linuxcan); or use the kernel's own driver with interface socketcan",
    "neousys": "install Neousys' wdt_dio library",
    "neovi": "install it with: pip install 'invid[neovi]', and Intrepid's driver",
    "nican": f"install NI-CAN; {_WINDOWS}",
    "nixnet": f"install it with: pip install 'invid[nixnet]', and NI-XNET; {_WINDOWS}",
    "pcan": "install PEAK's PCAN-Basic library (libpcanbasic); or use the kernel's own driver with interface "
    "socketcan",
    "robotell": "install it with: pip install 'invid[slcan]'",
    "seeedstudio": "install it with: pip install 'invid[slcan]'",
    "serial": "install it with: pip install 'invid[slcan]'",
    "slcan": "install it with: pip install 'invid[slcan]'",
    "socketcan": "load the kernel's CAN modules and bring the interface up: ip link set can0 up type can "
    "bitrate 1000000",
    "systec": f"install SYS TEC's USBCAN driver; {_WINDOWS}",
    "usb2can": f"install the vendor's usb2can library and pywin32; {_WINDOWS}",
    "vector": f"install Vector's XL driver library; {_WINDOWS}",
}
"""What each interface of python-can needs beside python-can."""
_MISSING = (ImportError, NameError, AttributeError, NotImplementedError)
"""What python-can's interfaces raise where the vendor's library is not there: some when they are imported,
some when the bus is opened, and Kvaser's names are then simply not defined."""


def open_adapter(bus: BusConfig) -> can.BusABC:
    """The bus that a config names.

    Raises
    ------
    ConfigError
        python-can has no such interface.
    BusError
        The vendor's library is missing, or the adapter cannot be opened.
    """
    if bus.interface not in can.VALID_INTERFACES:
        raise ConfigError(
            f"bus.interface {bus.interface!r} is not known to python-can; known are "
            + ", ".join(sorted(can.VALID_INTERFACES))
        )
    who = sentence("bus {interface} {channel}", interface=bus.interface, channel=bus.channel)
    try:
        return can.Bus(
            interface=bus.interface,
            channel=bus.channel,
            **{"bitrate": bus.bitrate_bit_per_s, **bus.options},
        )
    except Exception as error:  # every vendor's code raises what it likes
        said = " ".join(str(error).split()) or type(error).__name__
        needs = NEEDS.get(bus.interface, "")
        if isinstance(error, _MISSING) or (isinstance(error, OSError) and "library" in said):
            raise BusError(
                sentence(
                    "{who}: the driver of this interface is not there ({said}); {way_out}",
                    who=who,
                    said=said,
                    way_out=needs or sentence("install it"),
                )
            ) from None
        beside = sentence(". Where its driver is missing: {needs}", needs=needs) if needs else ""
        raise BusError(
            sentence(
                "{who}: cannot be opened ({said}); check that the interface is there, up and not in use, and "
                "bus.channel and bus.options in the config{beside}",
                who=who,
                said=said,
                beside=beside,
            )
        ) from None
