"""Where the files are that tests read or run."""

from pathlib import Path

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
STUDIES = ROOT / "studies"
STUDY = TESTS / "studies_for_tests.py"
COIN_STUDY = TESTS / "coin_study.py"
