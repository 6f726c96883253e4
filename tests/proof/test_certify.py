"""Proofs of loops whose worst is known, and proofs that were tampered with."""

import dataclasses
import json
import math
import os
import re
import shutil
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import places
import qsmc_jax as qj
from problems import STILL_BANDWIDTH, WIDTH
from proof import proofs
from qsmc_jax.proof.certify import load_proof
from qsmc_jax.proof.traced import traced

EXAMPLE_1 = "example1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Proofs of the quick studies, found by a program of its own that is compiled as for users."""
    return proved(tmp_path_factory, *(name for name in proofs.STUDIES if name != "third"))


def proved(tmp_path_factory, *names):
    folder = tmp_path_factory.mktemp("proofs")
    path = os.pathsep.join(map(str, (places.ROOT, places.ROOT / "tests")))
    environment = {**os.environ, "PYTHONPATH": path, "XLA_FLAGS": ""}
    subprocess.run([sys.executable, proofs.__file__, folder, *names], env=environment, check=True)
    return folder


@pytest.mark.parametrize(
    ("name", "bound", "reach", "gain"), [("still", 2, 0.2, 1), ("far", 1, 0.8, 1), ("weak", 3, 0.1, 0.5)]
)
def test_the_peak_of_a_loop_of_order_1_is_enclosed_closely(folder, name, bound, reach, gain):
    """|u| never exceeds the first input or D/g, and comes as near to that as one likes."""
    proof = load_proof(folder / name, proofs.STUDIES[name]())
    truth = max(math.tan(0.5 * math.pi * reach), bound / gain)
    assert proof.verdict == "PROVED"
    assert proof.until == math.inf
    assert truth <= proof.peak_u <= 1.01 * truth
    assert math.tan(0.5 * math.pi * proof.peak_ratio) == pytest.approx(proof.peak_u, rel=1e-9)
    assert proof.peak_errors == pytest.approx([proof.peak_ratio * WIDTH], rel=1e-12)
    assert proof.least_gain == gain


def test_runs_lie_within_the_tube_at_every_time(folder):
    """Signals of runs against the table of the proof, from which its picture is drawn."""
    proof, study = load_proof(folder / EXAMPLE_1), proofs.example(1)
    table = proof.table()
    times = 0.5 * (table["t"] + table["until"])
    found = qj.signals(study, range(8), ts=np.append(0.0, times))
    assert np.all(table["t"][1:] == table["until"][:-1])
    for i, name in ((found.sigma[:, 1:], "sigma"), (found.u[:, 1:], "u")):
        assert np.all(table[f"{name}_min"] <= i)
        assert np.all(i <= table[f"{name}_max"])
    assert np.all(np.abs(found.sigma[:, 1:]) < table["rho"])
    assert max(-table["u_min"].min(), table["u_max"].max()) <= proof.peak_u
    axes = proof.plot()
    assert [axis.get_xlabel() for axis in axes] == ["", "t [s]"]


@pytest.mark.parametrize(("name", "code", "told"), [("still", 0, "peak_u=2.00"), ("nothing", 2, "can't be read")])
def test_the_checker_needs_no_jax(folder, name, code, told):
    program = (
        "import runpy, sys; sys.modules['jax'] = None; runpy.run_module('qsmc_jax.proof.checker', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", program, folder / name], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert told in done.stdout + done.stderr


def test_a_proof_says_what_is_certain(folder):
    proof = load_proof(folder / "still")
    assert str(proof).startswith("PROVED: every run stays in its funnel for ever, with |sigma| / rho <= 0.70602")
    assert "every measurable |d| <= 2." in str(proof)
    assert proof.summary()["uncertain"] == {"x0": [-0.2, 0.2]}
    fixed = qj.Proof({**proof.content, "values": {"d": 0.5}}, proof.arrays)
    assert "  d              = 0.5, as given" in str(fixed)
    assert f"<= {math.ceil(proof.peak_u * 1e5) / 1e5:g}" in str(proof)


def test_a_proof_says_which_numbers_may_vary_along_a_run(folder):
    """Of one box all of the plant's; of several none by which they are told apart."""
    proof = load_proof(folder / EXAMPLE_1)
    assert proof.constant == ()
    assert "for all numbers in the box, constant or not, and every" in str(proof)
    names = proof.content["loop"]["names"]
    for cut, constant, told in (
        (["x0[0]"], (), ", constant or not, and"),
        (["mass", "x0[0]"], ("mass",), ", constant or not (constant: mass), and"),
        (["mass", "length", "friction"], ("mass", "length", "friction"), ", each constant along a run, and"),
    ):
        tree = [[names.index(name), (0.0).hex()] for name in cut]
        of_boxes = qj.Proof({**proof.content, "tree": tree}, proof.arrays)
        assert of_boxes.constant == constant
        assert told in of_boxes.conclusion()


def test_numbers_of_funnel_and_reference_are_constant():
    """Their rates are worked out for constant ones: a width that changes by itself would add to rho'."""
    assert traced(proofs.example(1))[0].constant == ()
    assert traced(proofs.example(2))[0].constant == ("rho0", "mu", "rho_inf")
    wave = lambda draw: qj.references.SumOfSines([draw.uniform("height", 0.1, 0.2)], [1.0])  # noqa: E731
    loop = proofs.still().nominal.loop

    def scenario(draw):
        moved = dataclasses.replace(loop, reference=wave(draw), plant=proofs.Integrator(draw.uniform("g", 1.0, 2.0)))
        return qj.Scenario(moved, x0=[draw.uniform("x0", 0.0, 0.1)], t1=3.0)

    found = traced(qj.Study(scenario, bandwidth=STILL_BANDWIDTH))[0]
    assert found.constant == ("height",)
    assert set(found.names) == {"height", "g", "x0"}


@pytest.mark.parametrize(
    ("study", "reason"),
    [
        (lambda: proofs.still(sign=-1.0), "the gain has the wrong sign at the start"),
        (lambda: proofs.still(gain=lambda draw: draw.uniform("g", -0.1, 1.0)), "the gain may be 0 at the start"),
        (lambda: proofs.still(reach=1.1), r"starts may lie outside the funnel, up to \|sigma\| / rho = 1.1"),
        (lambda: proofs.third((2.0, 2.0)), r"has the roots -1 \+- 1j: boxes of errors grow"),
        (lambda: own(lambda t, x: 0.1 * jnp.floor(t)), "computes by `floor`"),
        (lambda: own(lambda t, x: jnp.where(t > 1.0, 0.1, 0.2)), "`select_n`"),
        (lambda: ending(), "`select_n`.*jumps, cases, tables and loops have not"),
    ],
)
def test_what_is_not_proved_says_why(study, reason):
    proof = qj.certify(study(), boxes=1)
    assert proof.verdict == "NOT_PROVED"
    assert (proof.peak_u, proof.peak_ratio, proof.least_gain, proof.until) == (math.inf, math.inf, 0.0, 0.0)
    assert proof.peak_errors == ()
    assert re.search(reason, proof.reason)
    assert "This says nothing against the loop." in str(proof)


def own(drift, disturbance=None, x0=0.1):
    """A study of a plant of order 1 with a drift of its own and nothing uncertain."""

    class Own(qj.AbstractPlant):
        order = 1

        def drift(self, t, x):
            return drift(t, x)

        def gain(self, t, x):
            return 1.0

    disturbance = disturbance or qj.disturbances.Constant(0.1)
    loop = qj.ClosedLoop(Own(), proofs.REST, disturbance, proofs.still().nominal.loop.control)
    return qj.Study(lambda draw: qj.Scenario(loop, x0=[x0], t1=3.0), bandwidth=STILL_BANDWIDTH)


def ending():
    """In a funnel that is computed by cases: before the time at which it ends, and after it."""
    loop = proofs.still().nominal.loop
    control = dataclasses.replace(loop.control, funnel=qj.funnels.PrescribedTime(1.0, 1.0, 3.0, 0.5))
    moved = dataclasses.replace(loop, control=control)
    return qj.Study(lambda draw: qj.Scenario(moved, x0=[0.1], t1=3.0), bandwidth=0.7)


@pytest.mark.slow
def test_a_drift_that_is_not_bounded_is_not_proved_beyond_its_pole():
    proof = qj.certify(own(lambda t, x: 1.0 / (2.0 - t)), boxes=1)
    place = float(re.search(r"beyond t = ([0-9.]+) s", proof.reason)[1])
    assert proof.verdict == "NOT_PROVED"
    assert 1.9 < place <= 2.0


@pytest.mark.slow
def test_a_study_with_nothing_uncertain_is_proved_about_its_one_run():
    study = own(lambda t, x: -x[0])
    proof, run = qj.certify(study, boxes=8), study.replay(0)
    assert proof.verdict == "PROVED"
    assert proof.boxes == 1
    assert float(run.metrics.peak_u) <= proof.peak_u <= 1.05 * float(run.metrics.peak_u)


def with_draw(drawn):
    def scenario(draw):
        return qj.Scenario(proofs.still().nominal.loop, x0=[drawn(draw) * WIDTH], t1=30.0)

    return qj.Study(scenario, bandwidth=STILL_BANDWIDTH)


@pytest.mark.parametrize(
    ("study", "message"),
    [
        (lambda: with_draw(lambda draw: 0.1 * draw.normal("wide", 0.0, 1.0)), "Name `wide` must be bounded"),
        (
            lambda: with_draw(lambda draw: draw.uniform("wide", 0.0, draw.uniform("a", 0.1, 0.4))),
            "Name `wide` must have fixed bounds",
        ),
        (lambda: sampled(), "has an implementation: it is sampled"),
        (lambda: drawn_horizon(), "must have a fixed horizon"),
        (lambda: drawn_surface(), "must have a fixed sliding surface"),
    ],
)
def test_what_a_proof_does_not_cover_is_named(study, message):
    with pytest.raises(qj.InputError, match=message):
        qj.certify(study())


def sampled():
    loop = proofs.still().nominal.loop
    made = qj.ClosedLoop(loop.plant, loop.reference, loop.disturbance, loop.control, qj.Implementation(1e-3))
    return qj.Study(lambda draw: qj.Scenario(made, x0=[0.1], t1=1.0), bandwidth=STILL_BANDWIDTH)


def drawn_horizon():
    loop = proofs.still().nominal.loop
    return qj.Study(
        lambda draw: qj.Scenario(loop, x0=[0.1], t1=draw.uniform("t1", 1.0, 2.0)), bandwidth=STILL_BANDWIDTH
    )


def drawn_surface():
    def scenario(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([draw.uniform("c", 1.0, 2.0)]), qj.Funnel(4.0, 3.0, 0.05))
        loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), proofs.REST, qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[0.1, 0.1], t1=1.0)

    return qj.Study(scenario, bandwidth=0.1)


@pytest.mark.parametrize("argument", [{"boxes": 0}, {"target": -1.0}])
def test_arguments_are_checked(argument):
    with pytest.raises(qj.InputError, match=next(iter(argument))):
        qj.certify(proofs.still(), **argument)


def narrower(arrays):
    arrays["trunk_z"][..., arrays["trunk_z"].shape[-2] // 2, 1] -= 0.02


def start_outside(arrays):
    arrays["leaves_z"][..., 0, 1] *= 0.9


def later_knot(arrays):
    times = arrays["leaves_times"]
    times[..., 9] = 0.999 * times[..., 10]


def gap(arrays):
    arrays["trunk_times"] = arrays["trunk_times"] + 1e-9


def narrower_from_there_on(arrays):
    arrays["trunk_z"][:, 0, 1] -= 1e-9


def other_error(arrays):
    arrays["leaves_v"][:, 100, 0, 1] *= 0.9


@pytest.mark.parametrize("change", [narrower, start_outside, later_knot, gap, narrower_from_there_on, other_error])
def test_a_proof_whose_tube_was_tampered_with_is_refused(folder, tmp_path, change):
    shutil.copytree(folder / EXAMPLE_1, tmp_path / "proof")
    with np.load(tmp_path / "proof" / "tubes.npz") as found:
        arrays = dict(found)
    change(arrays)
    np.savez(tmp_path / "proof" / "tubes.npz", **arrays)
    refused(tmp_path / "proof")


def refused(folder, study=None):
    with pytest.raises(qj.InputError, match="must hold a proof that holds|must be that of the proof"):
        load_proof(folder, study)


def claim(content):
    content["claims"]["peak_u"] = math.nextafter(float.fromhex(content["claims"]["peak_u"]), 0.0).hex()


def domain(content):
    content["domain"][0][1] = (float.fromhex(content["domain"][0][1]) * 1.05).hex()


def bound(content):
    content["loop"]["program"][content["loop"]["places"]["bound"]] = ["const", (0.7).hex()]


def verdict(content):
    content["verdict"] = "NOT_PROVED"


def surface(content):
    content["loop"]["c"] = [(2.1).hex()]


def damaged(content):
    del content["claims"]


def of_nothing(content):
    del content["values"]


def tree(content):
    content["tree"] = [[0, (0.01).hex()], []]


@pytest.mark.parametrize("change", [claim, domain, bound, surface, tree, damaged])
def test_a_proof_whose_content_was_tampered_with_is_refused(folder, tmp_path, change):
    tampered(folder / EXAMPLE_1, tmp_path, change)
    refused(tmp_path)


def tampered(proof, folder, change):
    content = json.loads((proof / "proof.json").read_text())
    change(content)
    (folder / "proof.json").write_text(json.dumps(content))
    shutil.copy(proof / "tubes.npz", folder / "tubes.npz")


SWAPS = {"add": "sub", "sub": "add", "mul": "div", "div": "mul", "sin": "cos", "cos": "sin", "neg": "abs", "exp": "neg"}


def test_a_proof_of_another_loop_is_refused_whatever_operation_is_another(folder, tmp_path):
    """One operation of the program after the other: the study tells."""
    program = json.loads((folder / EXAMPLE_1 / "proof.json").read_text())["loop"]["program"]
    study, tried = proofs.example(1), 0
    for place, (name, *_) in enumerate(program):
        if name in SWAPS and place % 4 == 0:

            def change(content, place=place, name=name):
                content["loop"]["program"][place][0] = SWAPS[name]

            tampered(folder / EXAMPLE_1, tmp_path, change)
            refused(tmp_path, study)
            tried += 1
    assert tried > 3


def test_a_proof_is_of_its_study(folder, tmp_path):
    assert load_proof(folder / "still", proofs.still()).is_proved
    refused(folder / "still", proofs.still(bound=1.5))
    refused(folder / "still", proofs.still(reach=0.21))
    refused(folder / "nothing")
    other = proofs.still(bound=1.5)  # under its name

    def named(content):
        content["study"] = [list(part) for part in other.contents]

    tampered(folder / "still", tmp_path, named)
    assert load_proof(tmp_path).is_proved
    refused(tmp_path, other)
    tampered(folder / "still", tmp_path, of_nothing)
    refused(tmp_path, proofs.still())
    (tmp_path / "proof.json").write_text("[]")
    refused(tmp_path)


@pytest.mark.slow
def test_a_loop_of_order_3_with_a_pair_of_roots_and_all_that_a_law_has(tmp_path_factory):
    proof = load_proof(proved(tmp_path_factory, "third") / "third", proofs.third())
    runs = qj.monte_carlo(proofs.third(), 512)
    assert proof.verdict == "PROVED"
    assert proof.boxes == 2
    assert runs["peak_u"].max() < proof.peak_u
    assert runs["peak_ratio"].max() < proof.peak_ratio
    assert all(runs[f"peak_error[{i}]"].max() < each for i, each in enumerate(proof.peak_errors))
    assert proof.least_gain <= runs["least_gain"].min()


@pytest.mark.slow
def test_thousands_of_runs_and_the_worst_that_is_known_lie_within_the_bounds_of_example_1(folder):
    """An attack by constants at corners of the box gets to 8.029: mass, length, friction, x0, d."""
    proof, study = load_proof(folder / EXAMPLE_1), proofs.example(1)
    assert 8.029 < proof.peak_u < 24.0
    assert 0.0 < proof.least_gain <= 1.0 / (0.012 * 11.76**2)
    for table in qj.stream(study, range(8192), 1):
        assert table["peak_u"].max() < proof.peak_u
        assert table["peak_ratio"].max() < proof.peak_ratio < 1.0
        assert all(table[f"peak_error[{i}]"].max() < each for i, each in enumerate(proof.peak_errors))
        assert proof.least_gain <= table["least_gain"].min()
