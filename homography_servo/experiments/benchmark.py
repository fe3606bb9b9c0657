"""
Measure: accuracy and speed of each part, beside its peers, in the same run.

Each suite prints a table and writes it to benchmark/SUITE.txt, the numbers to
benchmark/SUITE.json as soon as they are known. Suites: pose, tracker, plan, servo,
latency.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
from pathlib import Path
import platform
import sys
import time
from typing import Any, Sequence

from homography_servo.threads import keep_to_one_thread

keep_to_one_thread()  # so that times compare

SUITES = ('pose', 'tracker', 'plan', 'servo', 'latency')


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(
        prog='benchmark', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='example:\n  benchmark pose tracker --quick')
    about.add_argument('suites', nargs='+', choices=SUITES, metavar='SUITE',
                       help=', '.join(SUITES))
    about.add_argument('--quick', action='store_true', help='seconds, with fewer samples')
    about.add_argument('--seed', type=int, default=1, help='seed of everything random')
    about.add_argument('--output', type=Path, default=Path('benchmark'), metavar='FOLDER')
    return about


def machine() -> dict[str, Any]:
    """Describe what the numbers were measured on."""
    import cv2
    import numpy
    import scipy
    return {'processor': platform.machine(), 'cores': os.cpu_count(),
            'system': platform.system(), 'python': platform.python_version(),
            'numpy': numpy.__version__, 'opencv': cv2.__version__, 'scipy': scipy.__version__}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Lay rows out as text, one column per key."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = [keys, *([_shown(row.get(key, '')) for key in keys] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(keys))]
    return '\n'.join('  '.join(word.ljust(width) for word, width in zip(line, widths)).rstrip()
                     for line in cells)


def _shown(value: Any) -> str:
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """Turn numpy numbers into JSON's; what is not finite becomes null."""
    if hasattr(value, 'item'):
        value = value.item()
    return None if isinstance(value, float) and value - value != 0.0 else value


def run_suite(name: str, options: argparse.Namespace) -> Path:
    """Run one suite, print its table, write it as text and the numbers as JSON."""
    module = importlib.import_module(f'homography_servo.experiments.benchmarks.{name}')
    began_s = time.monotonic()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / f'{name}.json'
    rows: list[dict[str, Any]] = []
    for row in module.run(options.quick, options.seed):
        rows.append({key: _plain(value) for key, value in row.items()})
        _write(path, options, rows, began_s, complete=False)
    _write(path, options, rows, began_s, complete=True)
    title = f'{name}: {(module.__doc__ or "").strip().splitlines()[0]}'
    text = f'{title}\n{table(rows)}\n({time.monotonic() - began_s:.0f} s)\n'
    path.with_suffix('.txt').write_text(text)
    print(f'\n{text}', end='', flush=True)
    return path


def _write(path: Path, options: argparse.Namespace, rows: list[dict[str, Any]], began_s: float,
           complete: bool) -> None:
    """Write what is known so far; a suite that is broken off leaves its rows behind."""
    from homography_servo import __version__
    content = {'suite': path.stem, 'version': __version__, 'machine': machine(),
               'quick': options.quick, 'seed': options.seed, 'complete': complete,
               'time_s': round(time.monotonic() - began_s, 1), 'rows': rows}
    partly = path.with_suffix('.part')
    partly.write_text(json.dumps(content, indent=1, allow_nan=False) + '\n')
    partly.replace(path)


def main(args: Sequence[str] | None = None) -> int:
    """Run the suites named on the command line."""
    options = parser().parse_args(args)
    for name in dict.fromkeys(options.suites):
        print(f'wrote {run_suite(name, options)}', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
