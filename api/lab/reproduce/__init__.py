"""The letter's figures and numbers, computed here and set beside the printed ones.

`courses.py` flies one scheme through one failure on paper; `batch.py` does many of them on all cores; `claims.py` holds
what the letter says and judges it; `figures.py` draws; `document.py` writes it up. `study.py` is the whole of it, and
`tuning.py` answers the letter's last sentence: which mu fits given limits. No number in the write-up is typed by hand.
"""

from skyfolio.api.lab.reproduce.study import FIGURES, Study, StudyConfig, run_study
from skyfolio.api.lab.reproduce.tuning import Limits, Tuning, tune

__all__ = ["FIGURES", "Limits", "Study", "StudyConfig", "Tuning", "run_study", "tune"]
