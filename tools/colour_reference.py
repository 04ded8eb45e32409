#!/usr/bin/env python3
"""Writes crates/blindaug/tests/colour_reference.csv: colours in each colour space and what they are in ACES2065-1, by OpenColorIO.

The numbers are those of OpenColorIO's own studio config and built-in transforms, not of blindaug. ProPhoto RGB, which is not among these, is that of
colour-science.
Needs: pip install opencolorio colour-science (2.6.0 and 0.4.7 were used).
"""

import pathlib

import colour as science
import PyOpenColorIO as ocio

SPACES = {
    "srgb": "sRGB Encoded Rec.709 (sRGB)",
    "rec709": "Gamma 2.4 Encoded Rec.709",
    "linear-srgb": "Linear Rec.709 (sRGB)",
    "acescg": "ACEScg",
    "aces2065-1": "ACES2065-1",
    "display-p3": "sRGB Encoded P3-D65",
    "adobe-rgb": "Gamma 2.2 Encoded AdobeRGB",
    "s-log3": "S-Log3 S-Gamut3",
    "s-log3-cine": "S-Log3 S-Gamut3.Cine",
    "logc3": "ARRI LogC3 (EI800)",
    "logc4": "ARRI LogC4",
    "v-log": "V-Log V-Gamut",
    "log3g10": "Log3G10 REDWideGamutRGB",
    "canon-log3": "CanonLog3 CinemaGamut D55",
}
CURVES = {"pq": "CURVE - ST-2084_to_LINEAR", "hlg": "CURVE - HLG-OETF-INVERSE"}
COLOURS = [(0.05, 0.3, 0.1), (0.2, 0.4, 0.5), (0.45, 0.45, 0.45), (0.6, 0.35, 0.7), (0.9, 0.8, 0.55)]



def main():
    config = ocio.Config.CreateFromBuiltinConfig("studio-config-latest")
    rec2020 = config.getProcessor("Linear Rec.2020", "ACES2065-1").getDefaultCPUProcessor()
    lines = ["space,r,g,b,aces_r,aces_g,aces_b"]
    for name in [*SPACES, *CURVES]:
        for colour in COLOURS:
            if name in SPACES:
                to_aces = config.getProcessor(SPACES[name], "ACES2065-1").getDefaultCPUProcessor()
                aces = to_aces.applyRGB(list(colour))
            else:
                curve = config.getProcessor(ocio.BuiltinTransform(CURVES[name])).getDefaultCPUProcessor()
                aces = rec2020.applyRGB(curve.applyRGB(list(colour)))
            lines.append(",".join([name, *(f"{v:.7g}" for v in (*colour, *aces))]))
    # The matrix of the chromaticities: the standard's own has four digits.
    science.RGB_COLOURSPACES["ProPhoto RGB"].use_derived_matrix_RGB_to_XYZ = True
    for rgb in COLOURS:
        aces = science.RGB_to_RGB(
            rgb, "ProPhoto RGB", "ACES2065-1", chromatic_adaptation_transform="Bradford", apply_cctf_decoding=True
        )
        lines.append(",".join(["prophoto", *(f"{v:.7g}" for v in (*rgb, *aces))]))
    path = pathlib.Path(__file__).parent.parent / "crates/blindaug/tests/colour_reference.csv"
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
