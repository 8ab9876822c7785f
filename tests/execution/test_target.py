"""What CPU kernels are compiled for, and how many lanes they have: from the environment and the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
import warp as wp
from click.testing import CliRunner

from wrt.cli import main
from wrt.kernels.compilation import host_cpu, target
from wrt.kernels.simd.lanes import native_width

ZEN_2 = frozenset(target.AVX2 | {"sse2", "clflushopt"})
ZEN_4 = frozenset(target.AVX512 | {"sse2", "avx512vbmi"})
QUICKER = " ".join(target.QUICKER)

SHOW = """
import json, sys
import warp as wp

@wp.func_native('''
#if defined(__AVX512F__)
    return 512;
#elif defined(__AVX2__)
    return 256;
#else
    return 128;
#endif
''')
def simd_bits() -> int: ...

def show(bits: wp.array(dtype=int)):
    bits[0] = simd_bits()

kernels = [wp.kernel(show, module="unique", enable_backward=False)]  # hashed here, with the flags of now
if len(sys.argv) > 1:
    from wrt.kernels.compilation.target import choose
    choose(sys.argv[1])
from wrt.kernels.simd.lanes import native_width
wp.config.log_level = wp.LOG_ERROR
bits = wp.zeros(1, dtype=int, device="cpu")
wp.launch(kernels[0], 1, [bits], device="cpu")
print(json.dumps([int(bits.numpy()[0]), native_width(wp.get_device("cpu")), wp.config.cpu_compiler_flags]))
"""
"""A program that says what its kernel was compiled for: by the environment, or by its argument when the kernel is there."""


@pytest.fixture
def set_cpu(monkeypatch):
    """Sets what the operating system tells of the CPU, one of AMD's unless `vendor` names another, and the environment."""

    def set_cpu(features: frozenset[str], vendor: str = "AuthenticAMD", **environment: str) -> None:
        monkeypatch.setattr(target, "cpu_features", lambda: features)
        monkeypatch.setattr(target, "cpu_information", lambda *names: vendor)
        monkeypatch.setattr(wp.config, "cpu_compiler_flags", wp.config.cpu_compiler_flags)
        for name in (target.TARGET_VARIABLE, target.WIDTH_VARIABLE):
            monkeypatch.setenv(name, "")  # so that the end of the test brings back what was there
            monkeypatch.delenv(name)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)

    return set_cpu


@pytest.mark.parametrize(
    ("features", "environment", "bits", "width"),
    [
        (ZEN_4, {}, 512, 16),
        (ZEN_2, {}, 256, 8),
        (frozenset(), {}, 128, 8),
        (ZEN_4, {"WRT_TARGET": ""}, 512, 16),
        (ZEN_4, {"WRT_TARGET": "native"}, 512, 16),
        (ZEN_4, {"WRT_TARGET": "x86-64-v3"}, 256, 8),
        (ZEN_2, {"WRT_TARGET": "x86-64-v3"}, 256, 8),
        (ZEN_4, {"WRT_TARGET": "x86-64-v4"}, 512, 16),
        (target.NEOVERSE_V2, {"WRT_TARGET": "neoverse-v2"}, 128, 8),
        (ZEN_2, {"WRT_WIDTH": "16"}, 256, 16),
        (ZEN_4, {"WRT_TARGET": "x86-64-v3", "WRT_WIDTH": "4"}, 256, 4),
    ],
)
def test_widths_and_registers(features, environment, bits, width, set_cpu):
    set_cpu(features, **environment)
    assert target.simd_bits() == bits
    assert target.lane_width() == native_width(wp.get_device("cpu")) == width


@pytest.mark.parametrize(
    ("features", "environment", "message"),
    [
        (ZEN_4, {"WRT_TARGET": "zen"}, r"'zen' \(WRT_TARGET\) is unknown; choose from native, x86-64-v3, x86-64-v4"),
        (
            ZEN_2,
            {"WRT_TARGET": "x86-64-v4"},
            "code for x86-64-v4: it has no avx512bw.*; choose from native, x86-64-v3$",
        ),
        (frozenset({"neon"}), {"WRT_TARGET": "x86-64-v3"}, "it has no abm, avx, avx2.*; choose from native$"),
        (ZEN_4, {"WRT_WIDTH": "5"}, r"'5' \(WRT_WIDTH\) must be 4, 8 or 16"),
        (ZEN_4, {"WRT_WIDTH": "many"}, "'many'"),
        (ZEN_2, {"WRT_TARGET": "x86-64-v4", "WRT_WIDTH": "8"}, "cannot run"),
        (ZEN_4, {"WRT_TARGET": "neoverse-n1"}, "it has no aes, asimd,.*; choose from native, x86-64-v3, x86-64-v4$"),
        (target.NEOVERSE_N1, {"WRT_TARGET": "neoverse-v2"}, "it has no bf16, i8mm, sve2; choose from native, neoverse-n1$"),
    ],
)
def test_what_cannot_be_is_refused(features, environment, message, set_cpu):
    """Before anything is compiled: otherwise the process would end at the first instruction that is not there."""
    set_cpu(features, **environment)
    flags = wp.config.cpu_compiler_flags
    with pytest.raises(ValueError, match=message):
        target.apply_environment()
    assert wp.config.cpu_compiler_flags == flags


def test_other_flags_stay(set_cpu):
    set_cpu(ZEN_4)
    wp.config.cpu_compiler_flags = "-march=native -mllvm=-inline-threshold=9"
    target.apply_environment()
    assert wp.config.cpu_compiler_flags == f"-march=native -mllvm=-inline-threshold=9 {QUICKER}"
    for name, expected in (
        ("x86-64-v4", "-target-cpu x86-64-v4 -mprefer-vector-width=512"),
        ("x86-64-v3", "-target-cpu x86-64-v3"),
        ("native", "-march=native"),
    ):
        for _ in range(2):
            set_cpu(ZEN_4, WRT_TARGET=name)
            target.apply_environment()
            assert wp.config.cpu_compiler_flags == f"{expected} -mllvm=-inline-threshold=9 {QUICKER}"
    wp.config.cpu_compiler_flags = None
    target.apply_environment()
    assert wp.config.cpu_compiler_flags == f"-march=native {QUICKER}"


@pytest.mark.parametrize(
    ("vendor", "features", "wide"),
    [("GenuineIntel", ZEN_4, True), ("GenuineIntel", ZEN_2, False), ("AuthenticAMD", ZEN_4, False)],
)
def test_intel_uses_its_full_registers(vendor, features, wide, set_cpu):
    """Clang's default for Intel's CPUs with AVX-512 is 256 bits: views and random rays took 1.4 to 1.9 times as long."""
    set_cpu(features, vendor)
    wide_native = "-march=native" + " -mprefer-vector-width=512" * wide
    for given, expected in (
        (None, wide_native),
        ("-march=native -mllvm=-inline-threshold=9", f"{wide_native} -mllvm=-inline-threshold=9"),
        ("-march=native -mprefer-vector-width=256", "-march=native -mprefer-vector-width=256"),
        ("-target-cpu x86-64-v3", "-target-cpu x86-64-v3"),
        ("", ""),
    ):
        wp.config.cpu_compiler_flags = given
        target.apply_environment()
        assert wp.config.cpu_compiler_flags == f"{expected} {QUICKER}".strip()
    wp.config.cpu_compiler_flags = None
    set_cpu(features, vendor, WRT_TARGET="native")
    target.apply_environment()
    assert wp.config.cpu_compiler_flags == f"{wide_native} {QUICKER}"


def test_choices(set_cpu, monkeypatch):
    set_cpu(ZEN_2, WRT_WIDTH="8")
    flags = wp.config.cpu_compiler_flags
    with pytest.raises(RuntimeError, match="Warp has started already; set WRT_TARGET in the environment of a new process"):
        target.choose("x86-64-v3", 8)
    monkeypatch.setattr(target, "has_started", lambda: False)
    for wrong in (("x86-64-v4", None), ("zen", None), (None, 3), ("x86-64-v3", 3)):
        with pytest.raises(ValueError, match=r"cannot run|is unknown|must be 4"):
            target.choose(*wrong)
        assert "WRT_TARGET" not in os.environ
        assert os.environ["WRT_WIDTH"] == "8"
        assert wp.config.cpu_compiler_flags == flags
    target.choose("x86-64-v3", 16)
    assert (os.environ["WRT_TARGET"], os.environ["WRT_WIDTH"]) == ("x86-64-v3", "16")
    assert wp.config.cpu_compiler_flags.startswith("-target-cpu x86-64-v3 ")
    target.choose()
    assert target.lane_width() == 16


@pytest.mark.width
def test_the_suite_runs_as_it_was_asked_to():
    """Whoever starts it with a target gets that target, although the suite has flags of its own."""
    asked = os.environ.get(target.TARGET_VARIABLE) or "native"
    assert wp.config.cpu_compiler_flags.startswith(" ".join(target.TARGETS[asked].flags))
    assert native_width(wp.get_device("cpu")) == target.lane_width()


@pytest.mark.parametrize("way", ["environment", "argument"])
def test_code_is_compiled_for_the_target(way, tmp_path):
    """The compiler is asked itself. An argument comes when kernels are there, as on the command line."""
    if target.AVX2 - target.cpu_features():
        pytest.skip("code for x86-64-v3 needs AVX2")
    program = tmp_path / "show.py"  # Warp reads the source of kernels
    program.write_text(("import wrt.device\n" if way == "environment" else "") + SHOW, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name not in ("WRT_TARGET", "WRT_WIDTH")}
    environment |= {"WRT_TARGET": "x86-64-v3"} if way == "environment" else {}
    arguments = ["x86-64-v3"] if way == "argument" else []
    done = subprocess.run([sys.executable, program, *arguments], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    bits, width, flags = json.loads(done.stdout.splitlines()[-1])
    assert (bits, width) == (256, 8)
    assert flags.startswith("-target-cpu x86-64-v3 -mllvm=-inline-threshold=")


def test_command_line(monkeypatch):
    chosen = []
    monkeypatch.setattr(target, "choose", lambda **given: chosen.append(given))
    for command in (["info"], ["render"], ["verify"], ["bench"], ["bench", "auto"]):
        result = CliRunner().invoke(main, [*command, "--target", "x86-64-v3", "--lanes", "4", "--help"])
        assert result.exit_code == 0, result.output
        assert chosen == [{"target": "x86-64-v3"}, {"width": 4}]
        chosen.clear()
    monkeypatch.undo()
    result = CliRunner().invoke(main, ["info", "--target", "zen"])
    assert result.exit_code == 2
    assert "--target" in result.stderr
    assert "'zen'" in result.stderr


def test_info_says_what_kernels_are_compiled_for():
    found = json.loads(CliRunner().invoke(main, ["info", "--level", "2", "--json"]).stdout)["CPU"]
    assert found["name"] == host_cpu.cpu_name()
    assert (found["target"], found["lanes"], found["SIMD bits"]) == (
        target.target_name(),
        target.lane_width(),
        target.simd_bits(),
    )
    assert found["threads"] >= 1


def test_the_compiler_knows_the_cpu_where_linux_does_not_tell(monkeypatch):
    """As on Windows and macOS: the same targets fit, and the CPU has a name."""
    able = {name for name, one in target.TARGETS.items() if one.needs <= host_cpu.cpu_features()}
    monkeypatch.setattr(host_cpu, "cpu_information", lambda *names: None)
    assert {name for name, one in target.TARGETS.items() if one.needs <= host_cpu.cpu_features()} == able
    assert host_cpu.cpu_name() == host_cpu.told_by_compiler("name") != ""
    assert host_cpu.told_by_compiler("age") == ""
