"""
Print what share of the core the tests have run, by package, and where it is missing.

Reads the file .coverage that `coverage run` has left. Ends with code 1 when less than
--aim percent of the statements were run.

Example: coverage run -m pytest test/geometry && python tools/coverage_by_package.py
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path
import sys

from coverage import Coverage

ROOT = Path(__file__).resolve().parents[1] / 'homography_servo'


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(description=__doc__,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
    about.add_argument('--aim', type=float, default=0.0, metavar='PERCENT')
    about.add_argument('--missing', action='store_true', help='also list lines that were not run')
    return about


def main() -> int:
    """Print the table."""
    options = parser().parse_args()
    coverage = Coverage()
    coverage.load()
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for file in sorted(coverage.get_data().measured_files()):
        _, statements, _, missing, lines = coverage.analysis2(file)
        parts = Path(file).relative_to(ROOT).parts
        for name in (parts[0] if len(parts) > 1 else 'ground', 'all'):
            counts[name][0] += len(statements)
            counts[name][1] += len(missing)
        if missing and options.missing:
            print(f'{"/".join(parts)}: {lines}')
    print(f'{"package":>12} {"statements":>11} {"run":>8}')
    share = 0.0
    for name in sorted(counts, key=lambda key: (key == 'all', key)):
        statements, missed = counts[name]
        share = 100.0 * (statements - missed) / max(statements, 1)
        print(f'{name:>12} {statements:11d} {share:6.1f} %')
    return 0 if share >= options.aim else 1


if __name__ == '__main__':
    sys.exit(main())
