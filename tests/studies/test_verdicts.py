"""The verdict on a claim: made-up tables in which it holds, fails and is undecided, for every claim; and what makes results."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from studies.__main__ import studies
from studies.evidence import page_filling, results
from studies.evidence.claims import CLAIMS
from studies.evidence.results import Results, Row, collect
from studies.evidence.single_runs import STUDIES, Effort
from studies.evidence.verdicts import (
    FAILS,
    HOLDS,
    NOT_COMPARABLE,
    UNDECIDED,
    Verdict,
    all_of,
    counted,
    judge,
    measured,
    not_comparable,
    smaller,
)
from studies.triangles import komatsu_tables
from wrt.scenes import build


@pytest.mark.parametrize(
    ("cases", "word"),
    [
        ([[1.2, 1.3, 1.4, 1.5, 1.1]], HOLDS),
        ([[1.2, 1.3, 1.4, 1.5, 0.9]], UNDECIDED),  # one run below
        ([[0.8, 0.7, 0.9, 0.8, 0.9]], FAILS),
        ([[1.2, 1.3, 1.4, 1.5]], UNDECIDED),  # four runs
        ([[1.2, 1.3, 1.4, 1.5, 1.1], [0.8, 0.7, 0.9, 0.8, 0.9]], FAILS),  # one case of two
        ([[1.2, 1.3, 1.4, 1.5, 1.1], [0.8, 0.7]], UNDECIDED),
        ([[1.0, 1.0, 1.0, 1.0, 1.0]], HOLDS),  # the bound is included
    ],
)
def test_a_claim_with_a_bound(cases, word):
    assert judge([measured(values, f"scene {k}") for k, values in enumerate(cases)], at_least=1.0).word == word


def test_what_is_counted_needs_one_run():
    assert judge([counted(0.5)], at_most=0.5).word == HOLDS
    assert judge([counted(0.51, "a"), counted(0.5, "b")], at_most=0.5) == Verdict(FAILS, "in 1 of 2 cases: a")
    assert judge([counted(6)], 6, 6).word == HOLDS
    assert judge([counted(2, "a"), counted(3, "b")], at_most=1).why == "in both cases"


def test_a_variant_is_compared_with_the_reference_and_not_the_reference_with_itself():
    """On most scenes is on more than half of them; the unit triangle's own rows decide nothing."""
    rows = [
        Row("6.2", {"scene": scene, "mode": "alone", "test": test}, {"ratio": counted(ratio)})
        for test, ratios in (("ferko_utm", (1.0,) * 4), ("a", (0.9, 0.9, 1.1, 1.1)), ("b", (0.9, 0.9, 0.9, 1.1)))
        for scene, ratio in zip("wxyz", ratios, strict=True)
    ]
    held = Results("pichler", {"measured": "", "commit": ""}, "", {}, (), rows)
    verdict, here = CLAIMS["pichler-variants"].judge({"pichler": held})
    assert verdict == Verdict(FAILS, "in 1 of 2 cases: b")
    assert "faster on 2 to 3 of 4 scenes" in here


def test_comparisons():
    low, high, wide = measured([1, 1.1, 1.2, 1.1, 1]), measured([2, 2.1, 2.2, 2.1, 2]), measured([1, 2, 3, 1, 2])
    assert [smaller(low, high).word, smaller(high, low).word, smaller(low, wide).word] == [HOLDS, FAILS, UNDECIDED]
    assert smaller(low, measured([3.0])).word == UNDECIDED


def test_parts_of_a_claim():
    yes, no, open_, other = Verdict(HOLDS), Verdict(FAILS), Verdict(UNDECIDED), not_comparable("watts there, seconds here")
    assert [all_of(v).word for v in ([yes, yes], [yes, open_], [open_, other], [other, no, open_])] == [
        HOLDS,
        UNDECIDED,
        NOT_COMPARABLE,
        FAILS,
    ]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: judge([], at_least=1), "no case"),
        (lambda: judge([counted(1)]), "has a bound"),
        (lambda: Verdict("maybe"), "no verdict"),
        (lambda: not_comparable(""), "why"),
        (lambda: replace(counted(1.0), least=2.0), "does not lie between"),
        (lambda: all_of([]), "no verdict"),
    ],
)
def test_a_judgement_needs_something_to_judge(make, message):
    with pytest.raises(ValueError, match=message):
        make()


DEPTHS = Results(
    "komatsu_depths", {"measured": "", "commit": ""}, "", {}, (),
    [Row("depths", {"scene": "a", "contender": "komatsu", "traversal": way, "limit": limit}, {"ratio": counted(1.0)})
     for way in ("packet", "single") for limit in ("none", "12", "10")],
)  # fmt: skip

NUMBERS = {
    "komatsu-operations": ("test", {"algorithm": "Proposed"}, 10, 30),
    "komatsu-break-even": ("precomputation", {"algorithm": "Proposed"}, 31, 300),
    "komatsu-without-tree": ("ratio", {"contender": "Proposed"}, 0.8, 1.2),
    "komatsu-pluecker": ("ratio", {"contender": "Proposed"}, 0.1, 5.0),
    "komatsu-exits": ("tests", {"exit": "u + v > 1"}, 0.1, 0.5),
    "komatsu-prediction": ("nanoseconds", {"contender": "Proposed, exits"}, 0.1, 5.0),
    "komatsu-precomputation": ("nanoseconds", {"contender": "Proposed, no exits"}, 0.1, 5.0),
    "komatsu-both": ("nanoseconds", {"contender": "Proposed, exits"}, 0.1, 5.0),
    "komatsu-tree": ("ratio", {"contender": "komatsu"}, 0.9, 1.2),
    "komatsu-large": ("ratio", {"contender": "komatsu"}, 0.7, 1.2),
    "komatsu-bundles": ("ratio_counted", {"contender": "Proposed"}, 0.9, 1.5),
    "pichler-probability": ("percent", {"variant": "3x, p.es."}, 1.0, 300.0),
    "pichler-variants": ("ratio", {}, 1.1, 0.9),
    "pichler-unit-triangle": ("ratio", {"test": "ferko_utm"}, 0.9, 1.1),
    "pichler-baldwin-weber": ("ratio", {"test": "baldwin_weber"}, 0.9, 1.1),
    "pichler-hybrid": ("ratio", {"test": "ferko_hybrid"}, 9.0, 0.1),
    "inside-first": ("tests", {"order": "inside first", "exit": "outside an edge"}, 0.9, 0.3),
    "memory-of-vertices": ("bytes", {"test": "wald"}, 60.0, 36.0),
    "fans-brute-force": ("ratio", {"way": ("fans", "fans, edges, normals")}, 0.3, 0.9),
    "fans-planes": ("ratio", {"way": "fans, planes"}, 0.1, 9.0),
    "fans-trees": ("ratio", {"way": ("fans, bvh", "fans, kdtree")}, 0.9, 1.1),
    "sorting-sweep": ("build", {"builder": "sorting_sweep"}, 5.0, 0.5),
    "between-medians": ("between", {"scene": "points"}, 100.0, 50.0),
    "packets": ("speed", {"traversal": "packet"}, 4.0, 0.5),
    "omnidirectional-steps": ("fewer", {"bounce": "0"}, 2.5, 1.0),
    "omnidirectional-bounce-9": ("fewer", {"bounce": "9"}, 2.0, 1.0),
    "rays-at-leaves": ("rays", {"bounce": "9"}, 2.0, 12.0),
    "vertex-culling": ("avoided", {"leaf": "512", "culling": "vertex"}, 95.0, 80.0),
    "subtrees": ("built", {}, 0, 6),
    "fuzzy-boxes": ("area", {"clusters": ("found", "found, best rest pose", "bones")}, 1e-6, 1e6),
    "instance-updates": ("update", {"way": "instances"}, 1e-6, 1e6),
    "instance-rays": ("trace", {"way": "instances"}, 1e-6, 1e6),
    "gkdtree": ("speed", {"way": "groups, built"}, 2.0, 0.9),
    "threads-streaming": ("speed", {"what": "streaming", "threads": "4"}, 3.0, 2.0),
    "threads-binned": ("speed", {"what": "binned", "threads": "4"}, 3.95, 3.0),
    "threads-nested": ("speed", {"what": "nested", "threads": "16"}, 6.0, 4.0),
    "threads-in-place": ("speed", {"what": "in_place", "threads": "16"}, 8.0, 4.0),
    "threads-groups": ("speed", {"what": "groups", "threads": "6"}, 4.0, 3.0),
    "threads-rays": ("speed", {"what": ("view", "random"), "threads": "16"}, 14.0, 9.0),
    "two-trees": ("trace", {"way": "static and moving kdtree"}, 1e6, 1e-6),
    "split-threads": ("split", {}, 1e-6, 1e6),
    "pah-precision": ("percent", {"error": "PAH, point, circular cap"}, 5.0, 23.0),
    "pah-spfh": ("percent", {"tree": "PAH + SPFH"}, 3.0, 30.0),
    "sah-spfh": ("percent", {"tree": "SAH + SPFH"}, 99.0, -9.0),
    "pah-alone": ("percent", {"tree": "PAH + LSPH"}, -3.0, 4.0),
    "sah-precision": ("percent", {"error": "SAH, plane and point"}, 51.0, 3.0),
    "pah-culling": ("percent", {"error": ("PAH, plane, not clipped", "PAH, point, not clipped")}, 60.0, 0.1),
}
"""By claim: a quantity on which it depends, in which rows, and a value with which it holds, and one with which it does not."""


def made_up(held: Results, quantity: str, key: dict, values: list[float]) -> Results:
    """The same results with other values; all others are settled, as if they were counted."""
    rows = []
    for row in held.rows:
        measures = {name: counted(measure.value) for name, measure in row.measures.items()}
        if quantity in measures and all(results.matches(row.key.get(k), v) for k, v in key.items()):
            measures[quantity] = measured(values)
        rows.append(replace(row, measures=measures))
    return replace(held, rows=rows)


@pytest.mark.parametrize("name", NUMBERS)
def test_a_claim_can_hold_fail_and_be_undecided(name):
    claim = CLAIMS[name]
    quantity, key, good, bad = NUMBERS[name]
    (needed,) = claim.needs
    held = DEPTHS if needed == "komatsu_depths" else results.load(needed)
    words = []
    for values in ([good] * 5, [bad] * 5, [good, bad, good, bad, good]):
        verdict, here = claim.judge({needed: made_up(held, quantity, key, values)})
        words.append(verdict.word)
        assert here
    counts = {
        "komatsu-break-even",
        "sah-precision",
        "pah-culling",
        "komatsu-operations",
        "memory-of-vertices",
    }
    counts |= {"komatsu-exits", "pah-precision", "sah-spfh"}
    assert words[:2] == [HOLDS, FAILS]
    assert words[2] == UNDECIDED or name in counts  # what is counted is judged by its value


def test_every_claim_is_tried():
    others = CLAIMS.keys() - NUMBERS.keys()
    assert others == {"pichler-errors", "threads-benthin"}
    assert {page_filling.judged(CLAIMS[name])[0].word for name in others} == {NOT_COMPARABLE}


def test_runs_become_results(tmp_path):
    runs = [{"4": [{"scene": "bunny", "hits": 7 + k, "ratio": 1.0 + k / 10, "share": 0.5}]} for k in range(5)]
    about = {"origin": {"of": "", "measured": "", "commit": ""}, "machine": "", "settings": {}, "sources": ()}
    found = collect("made_up", runs, **about)
    (ratio,), (share,) = found.take("4", "ratio", scene="bunny"), found.take("4", "share")
    assert (ratio.value, ratio.least, ratio.greatest, ratio.runs) == (1.2, 1.0, 1.4, 5)
    assert (share.value, share.runs, share.case) == (0.5, 0, "bunny")
    assert results.write(found, tmp_path).read_text(encoding="utf-8").endswith("]\n}\n")
    with pytest.raises(ValueError, match="in some of 6 runs only"):
        collect("made_up", [*runs, {"4": []}], **about)
    with pytest.raises(ValueError, match="no 'speed' in table '4'"):
        found.take("4", "speed")


def test_rounds_of_one_run_are_enough_where_they_are_kept():
    """Of a run that builds for minutes."""
    about = {"origin": {"of": "", "measured": "", "commit": ""}, "machine": "", "settings": {}, "sources": ()}
    row = {"scene": "a", "ratio": 1.0, "least": 0.9, "greatest": 1.1, "rounds": 5.0}
    (ratio,) = collect("made_up", [{"4": [row]}], **about).take("4", "ratio")
    assert (ratio.value, ratio.least, ratio.greatest, ratio.runs) == (1.0, 0.9, 1.1, 5)


def test_a_tessellated_mesh_is_the_same_surface():
    mesh = komatsu_tables.tessellated(build("teapot", level=2, ground=False), 2)
    plain = build("teapot", level=2, ground=False)
    assert mesh.triangle_count == 16 * plain.triangle_count
    areas = [
        np.linalg.norm(np.cross(*np.diff(m.vertices[m.faces], axis=1).transpose(1, 0, 2)), axis=-1).sum() for m in (mesh, plain)
    ]
    assert areas[0] == pytest.approx(areas[1], rel=1e-5)
    assert np.allclose(mesh.bounds, plain.bounds)


def test_a_command_makes_one_run(tmp_path):
    file = tmp_path / "run.json"
    done = CliRunner().invoke(studies, ["measure", "komatsu_counts", "--json", str(file)])
    assert done.exit_code == 0, done.output
    assert '"Proposed"' in file.read_text(encoding="utf-8")
    refused = CliRunner().invoke(studies, ["figures", "--collect", "komatsu", str(file)])
    assert refused.exit_code != 0
    assert "are runs of komatsu_counts, not of komatsu" in refused.output


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "name", ["komatsu_counts", "komatsu_scenes", "inside_first", "traversal", "kdtree_builders", "plane_places"]
)
def test_a_small_run_can_be_judged(name):
    """With built-in scenes, one round: all claims on it find their rows. The other studies compile for minutes."""
    study = STUDIES[name]
    tables = study.run(None, Effort(rounds=1, size=64, tests=1 << 12))
    about = {"origin": {"of": "", "measured": "", "commit": ""}, "machine": "", "settings": {}, "sources": ()}
    found = collect(name, [tables], study.is_counted, **about)
    for claim in CLAIMS.values():
        if [*claim.needs] == [name]:
            verdict, here = claim.judge({name: found})
            assert here
            assert verdict.word != HOLDS or study.is_counted


def test_why_figures_stay_has_to_be_said(tmp_path, monkeypatch):
    found = results.load("komatsu_counts")
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    path = results.write(found, tmp_path)
    with pytest.raises(ValueError, match="have not changed"):
        results.keep("komatsu_counts", "none", "2026-11-27")
    path.write_text(path.read_text().replace(results.recorded_hash("komatsu_counts"), "0" * 16))
    with pytest.raises(ValueError, match="say why"):
        results.keep("komatsu_counts", " ", "2026-11-27")
    results.keep("komatsu_counts", "a name has changed", "2026-11-27")
    held = json.loads(path.read_text())
    assert held["code"]["hash"] == results.code_hash(found.sources)
    assert held["code"]["kept"] == [{"date": "2026-11-27", "reason": "a name has changed"}]
    assert results.load("komatsu_counts") == found
