"""Units of length, in metres."""

SI_PREFIXES = {
    **{
        "yotta": 24,
        "zetta": 21,
        "exa": 18,
        "peta": 15,
        "tera": 12,
        "giga": 9,
        "mega": 6,
        "kilo": 3,
        "hecto": 2,
    },
    **{
        "deca": 1,
        "deci": -1,
        "centi": -2,
        "milli": -3,
        "micro": -6,
        "nano": -9,
        "pico": -12,
        "femto": -15,
    },
    **{"atto": -18, "zepto": -21, "yocto": -24},
}
"""Powers of ten by SI prefix."""

METRES_OF_NAMES = {
    **{f"{prefix}meter": 10.0**power for prefix, power in SI_PREFIXES.items()},
    **{
        "meter": 1.0,
        "angstrom": 1e-10,
        "inch": 0.0254,
        "foot": 0.3048,
        "yard": 0.9144,
        "mile": 1609.344,
    },
    "parsec": 3.0856775814913673e16,
}
"""Metres of the units that NGFF names."""

LENGTHS = {
    **METRES_OF_NAMES,
    **{f"{name}s": metres for name, metres in METRES_OF_NAMES.items()},
    **{"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6},
    **{"nm": 1e-9, "pm": 1e-12, "å": 1e-10, "ang": 1e-10, "micron": 1e-6, "microns": 1e-6},
    **{"metre": 1.0, "metres": 1.0, "kilometre": 1e3, "kilometres": 1e3},
}
"""Metres of units as files write them, by their names in small letters."""
