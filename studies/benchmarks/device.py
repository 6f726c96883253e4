"""First contact with an accelerator: is it right there, and how fast, against this machine's CPU and plain diffrax?

`python studies/benchmarks/device.py --out device.json` runs on whatever accelerator JAX finds, for at most eight
minutes, and prints tables; without one it runs on the CPU and says so. Each part is done in a process of its own, so
that one that fails, or takes too long, costs no other.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
BUDGET = 470.0  # seconds
BATCHES = {1: (1_000, 10_000, 100_000, 1_000_000), 2: (1_000, 10_000, 100_000)}
CPU_RUNS = 4096
COMPARED = 1024  # rows that must be those of the CPU


def oracles() -> dict[str, Any]:
    """Both examples against solutions made apart from this library: the largest relative error of each metric."""
    import numpy as np

    import qsmc_jax as qj

    solved = json.loads((ROOT / "tests" / "data" / "oracles.json").read_text())
    errors: dict[str, float] = {}
    for name in ("example1", "example2"):
        for each in solved[name]:
            run = qj.simulate(getattr(qj.paper, name)(), each["x0"], t1=each["T"], bandwidth=0.1)
            for metric, ours in (("sup_ratio", "peak_ratio"), ("sup_u", "peak_u"), ("reach_time", "reach_time")):
                error = abs(float(getattr(run.metrics, ours)) / each[metric] - 1.0)
                errors[f"{name} {metric}"] = float(np.maximum(errors.get(f"{name} {metric}", 0.0), error))
    return {"relative errors": errors, "met": max(errors.values()) < 1e-4}


def rows(example: int, file: str) -> dict[str, Any]:
    """Verdicts and peaks of some runs, written to a file."""
    import numpy as np

    import qsmc_jax as qj

    table = qj.monte_carlo(_study(example), COMPARED, block=COMPARED)
    np.savez(file, **{name: table[name] for name in ("verdict", "verdict_tracking", "peak_ratio", "total_variation_u")})
    return {}


def speed(example: int, batch: int, runs: int) -> dict[str, Any]:
    """Runs a second, once compiled, in blocks of one size; and the memory that was held at most."""
    import jax

    import qsmc_jax as qj

    study, block = _study(example), -(-batch // 64) * 64
    threads = None if jax.default_backend() == "cpu" else 1
    begin = time.perf_counter()
    qj.monte_carlo(study, block, seed=1, block=block, threads=threads)
    first = time.perf_counter() - begin
    count = max(1, round(runs / block)) * block
    begin = time.perf_counter()
    table = qj.monte_carlo(study, count, block=block, threads=threads)
    seconds = time.perf_counter() - begin
    lanes = table["steps"].sum() / (table["steps"].reshape(-1, block).max(axis=1) * block).sum()
    memory = (jax.devices()[0].memory_stats() or {}).get("peak_bytes_in_use", 0) / 2**20
    return {"runs/s": count / seconds, "first": first, "occupancy, unsorted": float(lanes), "MiB": memory}


def plain(example: int, batch: int) -> dict[str, Any]:
    """`jit(vmap(diffeqsolve))` of the same loops, peaks read off a grid."""
    import contestants
    import diffrax as dfx

    import qsmc_jax as qj

    study = _study(example)
    table = qj.monte_carlo(study, min(batch, 4096), block=4096)
    names = [f"x0[{i}]" for i in range(study.nominal.loop.order)]
    import numpy as np

    x0 = np.resize(np.stack([table[name] for name in names], axis=1), (batch, len(names)))
    amplitudes = np.resize(table["amplitude"], batch)
    solve = contestants.plain_diffrax((contestants.example1, contestants.example2)[example - 1], dfx.Tsit5)
    solve(x0, amplitudes, 0.05, 1e-6)
    begin = time.perf_counter()
    solve(x0, amplitudes, 0.05, 1e-6)
    return {"runs/s": batch / (time.perf_counter() - begin)}


def about() -> dict[str, Any]:
    """Versions and devices."""
    import diffrax
    import equinox
    import jax
    import numpy as np

    devices = [f"{each.platform} ({each.device_kind})" for each in jax.devices()]
    versions = {each.__name__: each.__version__ for each in (jax, diffrax, equinox, np)}
    return {"devices": devices, "python": platform.python_version(), "cores": os.cpu_count(), **versions}


def _study(example: int) -> Any:
    import race

    import qsmc_jax as qj

    return qj.Study(race.EXAMPLES[example][0], bandwidth=0.1)


PARTS = {part.__name__: part for part in (about, oracles, rows, speed, plain)}


class Session:
    """Parts in processes of their own, as long as there is time."""

    def __init__(self, budget: float):
        self.end = time.monotonic() + budget

    def do(self, part: str, on_cpu: bool = False, least: float = 15.0, **options: Any) -> dict[str, Any]:
        """What a part returns; `{"error": ...}` if it fails, runs out of memory or of time."""
        left = self.end - time.monotonic()
        if left < least:
            return {"error": "no time left"}
        environment = {**os.environ, **({"JAX_PLATFORMS": "cpu"} if on_cpu else {})}
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, __file__, "--part", json.dumps({"part": part, **options})]
        try:
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=left, cwd=ROOT)
        except subprocess.TimeoutExpired:
            return {"error": "no time left"}
        if done.returncode:
            return {"error": (done.stderr.strip().splitlines() or ["killed"])[-1][:300]}
        return json.loads(done.stdout.splitlines()[-1])


def compared(session: Session, example: int) -> dict[str, Any]:
    """Whether the device's verdicts are the CPU's, and by how much peaks differ."""
    import numpy as np

    with tempfile.TemporaryDirectory() as place:
        files = [str(Path(place, f"{name}.npz")) for name in ("device", "cpu")]
        for file, on_cpu in zip(files, (False, True), strict=True):
            done = session.do("rows", on_cpu, example=example, file=file)
            if "error" in done:
                return done
        device, cpu = (dict(np.load(file)) for file in files)
    changed = {name: int(np.sum(device[name] != cpu[name])) for name in ("verdict", "verdict_tracking")}
    apart = float(np.nanmax(np.abs(device["peak_ratio"] - cpu["peak_ratio"])))
    return {"runs": COMPARED, "verdicts changed": changed, "peaks apart": apart}


def main() -> None:
    """All parts, the most telling first."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--part", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds to spend at most")
    parser.add_argument("--largest", type=int, default=10**6, help="largest batch")
    asked = parser.parse_args()
    if asked.part:
        options = json.loads(asked.part)
        print(json.dumps(PARTS[options.pop("part")](**options)))
        return
    session, found = Session(asked.budget), {}

    def keep(name: str, result: dict[str, Any]) -> None:
        found[name] = result
        print(f"{name:44} {json.dumps(result)}", flush=True)
        if asked.out:
            asked.out.write_text(json.dumps(found, indent=2))

    keep("about", session.do("about"))
    keep("oracles", session.do("oracles"))
    for example in (1, 2):
        keep(f"example {example}: verdicts against the CPU's", compared(session, example))
    for example in (1, 2):
        keep(
            f"example {example}: this CPU, batch 512",
            session.do("speed", on_cpu=True, example=example, batch=512, runs=CPU_RUNS),
        )
        for batch in (each for each in BATCHES[example] if each <= asked.largest):
            keep(f"example {example}: batch {batch}", session.do("speed", example=example, batch=batch, runs=batch))
            if batch <= 100_000:
                keep(
                    f"example {example}: plain diffrax, batch {batch}",
                    session.do("plain", example=example, batch=batch),
                )


if __name__ == "__main__":
    main()
