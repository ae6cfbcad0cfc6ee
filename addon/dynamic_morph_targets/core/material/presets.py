# SPDX-License-Identifier: GPL-3.0-or-later
"""Material presets from published measurements, and the table of them in the docs. Never touches bpy."""

from __future__ import annotations

import sys
from dataclasses import astuple, dataclass
from math import pi
from pathlib import Path

import numpy as np

from ..settings import Material

POISSON = 0.4  # real soft tissue is nearly incompressible, 0.5; linear tetrahedra lock above 0.4
TABLE_BEGIN, TABLE_END = "<!-- presets -->", "<!-- end of presets -->"
REFERENCE = 2 * pi * 5.0  # rad/s, at which the presets have the measured damping; soft tissue bounces at about 5 Hz


@dataclass(frozen=True)
class Preset:
    """A measured material. source: what was measured, how, by whom, and how it was converted."""

    label: str
    material: Material
    source: str


def _preset(label: str, density: float, loss: float, source: str, *, young: float = 0.0, shear: float = 0.0) -> Preset:
    """A preset from Young's or the shear modulus (Pa), density (kg/m^3) and loss factor.

    A shear modulus becomes E = 2 mu (1 + nu), so that the engine's mu is the measured one. Tissue loses about the same
    fraction at any frequency; alpha = zeta w, beta = zeta / w is the flattest approximation by Rayleigh damping around
    w.
    """
    stiffness = young or 2 * shear * (1 + POISSON)
    zeta = loss / 2
    material = Material(float(f"{stiffness:.3g}"), POISSON, density, zeta * REFERENCE, zeta / REFERENCE)
    return Preset(label, material, source)


def _springpot_loss(exponent: float) -> float:
    """Loss factor of a springpot, G* ~ (i w)^exponent."""
    return float(np.tan(pi / 2 * exponent))


_DENSITY = "Density: Kaye & Laby, Tables of Physical and Chemical Constants, 2.4.6."
_BREAST_LOSS = (
    "Damping: ratio 0.215 of the breast's free vibration, Chen, Ng, Yu, Zhou & Wan 2013, Ergonomics 56(5), 868-878."
)
_MUSCLE_LOSS = (
    "Damping: springpot exponent {} of the thigh's muscle, MR elastography at 25-62.5 Hz, Klatt et al. 2010, Phys. "
    "Med. Biol. 55, 6445, doi 10.1088/0031-9155/55/21/007."
)
_GUESSED_LOSS = "Damping: assumed, loss factor {}."
PRESETS: dict[str, Preset] = {
    "FAT": _preset(
        "Fat", 923.0, 0.43,
        "Shear modulus 752 Pa of the buttock's fat in vivo, MR elastography at 50 Hz: Hatt, Lloyd, Bolsterlee & "
        f"Bilston 2023, J. Mech. Behav. Biomed. Mater., doi 10.1016/j.jmbbm.2023.105924. {_BREAST_LOSS} {_DENSITY}",
        shear=752.0,
    ),
    "FAT_FIRM": _preset(
        "Fat, Firm", 923.0, 0.43,
        "Shear modulus 3.04 kPa of the thigh's subcutaneous fat in vivo, MR elastography: Chakouch, Charleux & "
        f"Bensamoun 2015, PLoS ONE 10(9), e0138873. {_BREAST_LOSS} {_DENSITY}",
        shear=3.04e3,
    ),
    "BREAST": _preset(
        "Breast", 1020.0, 0.43,
        "Young's modulus 3.04 kPa of fatty and fibroglandular tissue in vivo, suction: Briot, Chagnon, Connesson & "
        "Payan 2022, Clin. Biomech. 99, 105743; fat and gland are alike at small strain, Samani, Zubovits & Plewes "
        f"2007, Phys. Med. Biol. 52, 1565. {_BREAST_LOSS} {_DENSITY}",
        young=3.04e3,
    ),
    "MUSCLE_RELAXED": _preset(
        "Muscle, Relaxed", 1047.0, _springpot_loss(0.253),
        "Shear modulus 3.91 kPa of the rectus femoris at rest, MR elastography: Chakouch, Charleux & Bensamoun 2015, "
        f"PLoS ONE 10(9), e0138873. {_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        shear=3.91e3,
    ),
    "MUSCLE_FLEXED": _preset(
        "Muscle, Flexed", 1047.0, _springpot_loss(0.270),
        "Shear modulus 123 kPa along the fibers of the tibialis anterior at maximum voluntary contraction, ultrasound "
        "elastography: In vivo tibialis anterior muscle mechanics through force estimation using ankle joint moment "
        f"and shear wave elastography, 2025, 14 volunteers. {_MUSCLE_LOSS.format('0.270')} {_DENSITY}",
        shear=123e3,
    ),
    "TONGUE": _preset(
        "Tongue", 1047.0, _springpot_loss(0.253),
        "Storage shear modulus 2.67 kPa in vivo, MR elastography: Cheng, Gandevia, Green, Sinkus & Bilston 2011, J. "
        "Biomech. 44(3), 450-454, doi 10.1016/j.jbiomech.2010.09.027. "
        f"{_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        shear=2.67e3,
    ),
    "CHEEK": _preset(
        "Cheek", 1047.0, _springpot_loss(0.253),
        "Young's modulus 31 to 42 kPa of cheek, cheekbone, forehead and lip with their skin in vivo, suction, the "
        f"middle taken: Luboz, Promayon & Payan 2014, HAL hal-01092748. {_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        young=36e3,
    ),
    "SKIN": _preset(
        "Skin", 1150.0, 0.14,
        "Young's modulus 56.3 kPa of the breast's skin in vivo, suction: Briot, Chagnon, Connesson & Payan 2022, Clin. "
        "Biomech. 99, 105743. Damping: loss factor 0.14 of pig skin at 1 Hz, Kirkpatrick, Duncan & Fang 2004, J. "
        f"Biomed. Opt. 9(6), doi 10.1117/1.1803843. {_DENSITY}",
        young=56.3e3,
    ),
    "GELATIN": _preset(
        "Gelatin", 1000.0, 0.06,
        "Young's modulus 4.34 kPa of gelatin in 20 parts of water, compression: Bonavia et al. 2025, arXiv:2512.20502. "
        "Damping: loss factor 0.06 of a soft gel at 20 Hz, Okamoto, Clayton & Bayly 2011, Phys. Med. Biol. 56, 6379. "
        "Density: assumed, as water.",
        young=4.34e3,
    ),
    "SILICONE_SOFT": _preset(
        "Silicone, Soft", 1070.0, 0.1,
        "100 % modulus 69 kPa (10 psi) and specific gravity 1.07 of Ecoflex 00-30: manufacturer's bulletin, Smooth-On. "
        f"Neo-Hookean: mu = 69 kPa / (2 - 1/4). {_GUESSED_LOSS.format(0.1)}",
        shear=69e3 / 1.75,
    ),
    "SILICONE_FIRM": _preset(
        "Silicone, Firm", 1030.0, 0.1,
        "Young's modulus 1.32 MPa of Sylgard 184 cured at 25 C, tension: Johnston, McCluskey, Tan & Tracey 2014, J. "
        "Micromech. Microeng. 24, 035017. Density: manufacturer's data sheet, Dow. "
        f"{_GUESSED_LOSS.format(0.1)}",
        young=1.32e6,
    ),
    "RUBBER": _preset(
        "Rubber", 950.0, 0.05,
        "Shear modulus 0.5 MPa and density of vulcanized natural rubber: MatWeb, Natural Rubber, Vulcanized. "
        f"{_GUESSED_LOSS.format(0.05)}",
        shear=0.5e6,
    ),
}  # fmt: skip


def table() -> str:
    """The presets as a Markdown table, for docs/materials.md."""
    head = "| Material | E, kPa | Poisson | Density, kg/m³ | Mass damping, 1/s | Stiffness damping, ms | Source |"
    rows = [head, "|---|--:|--:|--:|--:|--:|---|"]
    for preset in PRESETS.values():
        e, nu, rho, alpha, beta = astuple(preset.material)
        values = f"{e / 1e3:g} | {nu:.2g} | {rho:.0f} | {alpha:.2g} | {1e3 * beta:.2g}"
        rows.append(f"| {preset.label} | {values} | {preset.source} |")
    return "\n".join(rows) + "\n"


def write_table(path: Path) -> None:
    """Put `table` between the marks of a Markdown file."""
    before, begin, rest = path.read_text(encoding="utf-8").partition(TABLE_BEGIN)
    _, end, after = rest.partition(TABLE_END)
    if not end:
        raise ValueError(f"'{path}': the marks {TABLE_BEGIN} and {TABLE_END} are missing")
    path.write_text(f"{before}{begin}\n{table()}{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    write_table(Path(sys.argv[1]))
