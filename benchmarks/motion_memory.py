"""The most memory that converting a large database of motion takes, and its speed; made up here, deleted afterwards.

`--rows 4353570` is the size of the published database: 11 GB to write and to read, twice, beside the tables.
"""

import argparse
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
from measuring import peak_mib, print_table

CYCLE = 45
"""Rows of a made-up cycle."""
CYCLES = 400
"""Cycles of a made-up clip, which is five minutes long."""
COPIES = (10, 1)
"""How often each cycle occurs: ten times, like those of flat clips, or once, where every row has to be written."""
MIB = 2**20


def walk(rows: int, cycle: int, width: int, key: int) -> "np.ndarray":
    """Return rows of a cycle: smooth, like motion, and the same for the same key."""
    generator = np.random.default_rng([cycle, key])
    amplitude, offset = generator.normal(0, 10, (2, width))
    angle = np.linspace(0, 2 * np.pi, rows)[:, None] + generator.uniform(0, 6, width)
    noise = generator.normal(0, 0.01, (rows, width))
    return (offset + amplitude * np.sin(angle) + noise).astype(np.float32)


def cycle_rows(name: str, cycle: int) -> "np.ndarray":
    """Return the rows of the array `name` in a cycle."""
    if name == "Pun":
        return np.linspace(0, 1, CYCLE, dtype=np.float32)
    return walk(CYCLE, cycle, {"Xun": 342, "Yun": 311}[name], 0 if name == "Xun" else 1)


def make(path: Path, rows: int, patches: int) -> None:
    """Write a database of about so many rows, cycle by cycle, with `meta`."""
    copies = rows // CYCLE
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, width in {"Xun": 342, "Yun": 311, "Pun": None}.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                shape = (copies * CYCLE, width) if width else (copies * CYCLE,)
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, header)
                for copy in range(copies):
                    if copy % patches == 0:
                        data = cycle_rows(name, copy // patches).tobytes()
                    file.write(data)
        cycles = np.repeat(np.arange(copies) // patches, CYCLE)
        patch, within = np.repeat(np.arange(copies) % patches, CYCLE), np.tile(np.arange(CYCLE), copies)
        columns = [cycles // CYCLES, cycles % CYCLES * (CYCLE - 1) + within, cycles % CYCLES, patch]
        with archive.open("meta.npy", "w") as file:
            np.lib.format.write_array(file, np.stack(columns, axis=1).astype(np.int32))
        with archive.open("clips.npy", "w") as file:
            np.lib.format.write_array(file, np.array([f"clip{clip:03d}" for clip in range(cycles[-1] // CYCLES + 1)]))


def convert(folder: Path) -> None:
    """Convert the database in `folder`; print the memory before, the peak and the seconds."""
    from addressed_dynamics.sources.motion.conversion import convert_motion
    from addressed_dynamics.sources.motion.params import MotionConvertParams

    params = MotionConvertParams(
        validation_share=0.1, test_share=0.1, cycles_share=0.05, rows_share=0.02, split_seed=0, row_group_rows=2**13
    )
    before, start = peak_mib(), time.perf_counter()
    convert_motion(folder / "database.npz", folder / "tables", folder / "reports", params, lambda _: None)
    print(before, peak_mib(), time.perf_counter() - start)


def step(*arguments: str) -> list[float]:
    """Run one of the functions above in a process of its own, which inherits no memory, and return what it prints."""
    done = subprocess.run([sys.executable, __file__, *arguments], stdout=subprocess.PIPE, text=True, check=True)
    return [float(number) for number in done.stdout.split()]


def main(rows: int, copies: list[int]) -> None:
    """Print the peaks."""
    results = []
    for patches in copies:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            # In a process of its own: a child's peak begins at that of its parent.
            step("--make", temporary, "--rows", str(rows), "--copies", str(patches))
            size = (folder / "database.npz").stat().st_size / MIB
            before, peak, seconds = step("--convert", temporary)
            results.append([
                f"convert {rows:,} rows, {patches} of each cycle", f"{before:.0f} MiB", f"{peak:.0f} MiB",
                f"{rows / seconds:,.0f} rows/s", f"the database has {size:,.0f} MiB; target: < 1,500 MB",
            ])  # fmt: skip
    print_table(["", "before", "peak", "speed", ""], results)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=200_000, help="rows of the made-up database")
    parser.add_argument("--copies", type=int, nargs="+", default=COPIES, help="how often each cycle occurs in it")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--convert", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.make:
        make(arguments.make / "database.npz", arguments.rows, arguments.copies[0])
    elif arguments.convert:
        convert(arguments.convert)
    else:
        main(arguments.rows, arguments.copies)
