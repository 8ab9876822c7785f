"""Tables of the documents, as printed, with the place where they stand.

`READ` says when a table was last compared with the document, number by number. Pages are those printed in the document; where
the text version has lost its page breaks, the section stands instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Column = tuple[float | None, ...]

READ = "2026-11-27"


@dataclass(frozen=True)
class Table:
    """A table of a document.

    Attributes:
        document: key of `DOCUMENTS`.
        number: as printed.
        place: page or section.
        quantity: what the numbers are, with their unit.
        columns: heading of each number of a row.
        rows: by their heading; None where the document has a dash.
        read: date of the last comparison with the document.
    """

    document: str
    number: str
    place: str
    quantity: str
    columns: tuple[str, ...]
    rows: Mapping[str, Column]
    read: str = READ

    def __post_init__(self) -> None:
        for name, row in self.rows.items():
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.document}, table {self.number}, {name}: {len(row)} numbers, {len(self.columns)} columns"
                )

    def row(self, name: str) -> dict[str, float | None]:
        """A row by its columns."""
        return dict(zip(self.columns, self.rows[name], strict=True))

    def ratio(self, over: str, under: str) -> dict[str, float]:
        """One row divided by another, column by column."""
        pairs = zip(self.columns, self.rows[over], self.rows[under], strict=True)
        return {column: a / b for column, a, b in pairs if a is not None and b is not None}


DOCUMENTS = {
    "komatsu": "Komatsu et al. 2008, IPSJ Transactions on Advanced Computing Systems 1(1), pages 85 to 95",
    "pichler": "Pichler 2018, diploma thesis, TU Wien",
    "falcone": "Falcone 2024, MSc thesis, Politecnico di Milano",
    "rahikainen": "Rahikainen 2013, MSc thesis, University of Tampere",
}

MODELS = ("bunny", "dragon", "happy buddha", "armadillo", "asian dragon", "thai statue")

KOMATSU_1 = Table(
    "komatsu",
    "1",
    "section 3",
    "floating-point operations and bytes of a test",
    ("precomputation", "test", "bytes"),
    {"Möller": (0, 34, 48), "Projection": (0, 22, 40), "Pluecker": (41, 21, 52), "Proposed": (26, 17, 40)},
)
"""Bytes are in the text below the table."""

KOMATSU_2 = Table(
    "komatsu",
    "2",
    "section 4",
    "seconds for 256 x 256 pixels, without a tree",
    MODELS,
    {
        "Möller": (36.8, 589.9, 731.4, 256.6, 4130.7, 6632.8),
        "Projection": (36.7, 587.2, 754.2, 271.9, 4236.7, 6557.1),
        "Pluecker": (35.9, 532.8, 673.2, 252.0, 4826.7, 6123.7),
        "Proposed": (30.5, 496.0, 601.3, 231.1, 3191.5, 5240.8),
    },
)

KOMATSU_3 = Table(
    "komatsu",
    "3",
    "section 4",
    "per cent of the tests that end early, by exit",
    ("first", "second", "third", "last"),
    {
        "Möller": (20.9, 37.9, 27.8, 13.5),
        "Projection": (29.6, 34.2, 24.3, 11.9),
        "Pluecker": (20.9, None, None, 79.1),
        "Proposed": (20.9, 37.9, 27.8, 13.5),
    },
)

KOMATSU_4 = Table(
    "komatsu",
    "4",
    "section 4",
    "seconds for 256 x 256 pixels, with a SAH-BVH, in C without intrinsics",
    MODELS,
    {"Möller": (0.155, 0.150, 0.186, 0.106, 5.26, 33.6), "Proposed": (0.150, 0.146, 0.180, 0.104, 3.67, 25.6)},
)

PICHLER_61 = Table(
    "pichler",
    "6.1",
    "page 66",
    "thousands of comparisons",
    ("Bathroom", "Coffee-splash", "Chopper-titan"),
    {
        "3x": (2489117, 21870580, 131623897),
        "3x, p.es.": (2101578, 17747579, 111800423),
        "3x, p.es., w.": (2100807, 17747579, 111800369),
        "4x": (2965974, 25738931, 144438541),
        "4x, p.es.": (2551236, 20837681, 118144192),
        "4x, p.es., w.": (2554387, 20882274, 118240240),
        "3x, p.es., w., bb.": (2484093, 21863053, 131645889),
        "4x, p.es., bb.": (2945811, 25069369, 138406541),
    },
)
"""The percentages printed beside them are a tenth too high for Coffee-splash (81.2 for 81.15)."""

PICHLER_62 = Table(
    "pichler",
    "6.2",
    "page 67",
    "rendering time, per cent of the unit triangle test's",
    ("Buddha", "Killeroo", "Fractal-Buddha", "Glass", "Microcity"),
    {
        "3x": (100.90, 100.47, 101.46, 100.06, 100.64),
        "3x, p.es.": (100.37, 100.55, 101.63, 100.13, 100.72),
        "3x, p.es., w.": (100.58, 100.76, 101.42, 99.94, 101.40),
        "3x, p.es., w., bb.": (101.64, 98.80, 101.02, 99.50, 100.76),
        "4x": (101.17, 100.55, 101.28, 99.74, 100.84),
        "4x, p.es.": (103.13, 100.60, 101.95, 100.35, 101.75),
        "4x, p.es., w.": (102.18, 100.83, 101.87, 99.70, 101.26),
        "4x, p.es., bb.": (100.53, 98.86, 101.32, 100.34, 100.68),
    },
)

PICHLER_63 = Table(
    "pichler",
    "6.3",
    "page 70",
    "hit rate in per cent; rendering time, per cent of PBRT's own test",
    ("hit rate", "Baldwin-Weber", "UTM", "hybrid"),
    {
        "Chopper-titan": (9.20, 94.00, 96.12, 96.48),
        "Fractal-Buddha": (13.15, 93.30, 95.82, 97.16),
        "Coffee-splash": (15.61, 96.27, 96.88, None),
        "Bathroom": (20.89, 96.36, 97.23, None),
        "Buddha": (22.65, 96.87, 96.67, 98.51),
        "Killeroo": (22.89, 98.11, 98.05, 96.71),
        "Teapot": (28.00, 99.51, 99.38, None),
        "Glass": (31.52, 97.13, 98.08, 97.50),
        "Microcity": (38.57, 94.87, 95.96, 95.98),
        "Cloud": (45.07, 95.67, 96.21, None),
    },
)

PICHLER_64 = Table(
    "pichler",
    "6.4",
    "page 72",
    "mean squared error of a picture after equal rendering time",
    ("Microcity", "Killeroo", "Fractal-Buddha"),
    {
        "Pharr et al.": (0.0011146, 0.1015484, 0.00033312954),
        "Baldwin-Weber": (0.0010415, 0.1278213, 0.00031241373),
        "UTM": (0.0010349, 0.1196676, 0.00039471788),
    },
)

FALCONE_PRECISION = Table(
    "falcone",
    "text of 6.2.1 and 6.2.2",
    "page 96",
    "per cent, |real cost - estimated cost| / estimated cost, on average",
    ("PAH", "SAH", "PAH, planes", "PAH, points", "PAH, planes, not culled", "PAH, points, not culled"),
    {"eight scenes": (7, 36, 2, 12, 12, 23)},
)

FALCONE_61 = Table(
    "falcone",
    "6.1",
    "page 115",
    "cost of traversal",
    ("4 levels", "5 levels", "6 levels"),
    {"without fallback": (100.5, 88.7, 87.6), "with fallback": (115.5, 101.4, 99.8)},
)

FALCONE_63 = Table(
    "falcone",
    "6.3",
    "page 117",
    "properties, and the averages of BVH cost, planes tried and fallbacks a node",
    ("quality", "acceptable", "excellent", "cost", "planes", "fallbacks"),
    {
        "case 0": (0.4, 1.3, 0.9, 110.5, 1.8, 0.34),
        "case 1": (0.1, 1.3, 0.9, 88.4, 2.4, 0.13),
        "case 2": (0.8, 1.3, 0.9, 148.3, 1.5, 0.68),
        "case 3": (0.4, 1.1, 0.7, 69.1, 2.0, 0.41),
        "case 4": (0.4, 1.5, 1.1, 124.6, 1.7, 0.29),
    },
)
"""The text above the table has 69.2 and 40 % in case 3."""

KOMATSU = (KOMATSU_1, KOMATSU_2, KOMATSU_3, KOMATSU_4)

PICHLER = (PICHLER_61, PICHLER_62, PICHLER_63, PICHLER_64)

TABLES = (*KOMATSU, *PICHLER, FALCONE_PRECISION, FALCONE_61, FALCONE_63)


def break_even(precomputed: str, plain: str = "Möller") -> int:
    """The fewest rays of a frustum at which precomputation pays in operations, by Komatsu's Table 1."""
    once, each, whole = (
        KOMATSU_1.row(precomputed)["precomputation"],
        KOMATSU_1.row(precomputed)["test"],
        KOMATSU_1.row(plain)["test"],
    )
    rays = 1
    while once + each * rays >= whole * rays:
        rays += 1
        if rays > 10_000:
            raise ValueError(f"{precomputed} never needs fewer operations than {plain}")
    return rays
