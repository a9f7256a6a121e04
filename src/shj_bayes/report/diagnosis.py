"""The page of a diagnosis: what did the model leave out."""

from pathlib import Path

from jinja2 import UndefinedError

from shj_bayes.errors import ReportError
from shj_bayes.report import diagnosis_words as say
from shj_bayes.report.diagnosis_data import read_diagnosis
from shj_bayes.report.page import LOOPS, PAGE, write_page
from shj_bayes.report.viewer import diagnosis_viewer, thinning_words


def render_diagnosis(folder: Path) -> Path:
    """Write ``diagnosis.html`` of a finished diagnosis, one file that needs nothing else; `ReportError` without one."""
    # Drawing needs matplotlib, whose import takes a second that commands without a page need not wait for.
    from shj_bayes.report.diagnosis_pictures import draw  # noqa: PLC0415

    data = read_diagnosis(folder)
    try:
        viewer = diagnosis_viewer(data)
        content = {
            "name": data.record.device,
            "data": data,
            "force": data.force,
            "record": data.record,
            "say": say,
            "changed": data.channels.changed,
            "pictures": draw(data),
            "viewer": viewer,
            "thinning": thinning_words(viewer),
            "fit": PAGE if (folder / PAGE).exists() else "",  # page of the fit that lies in the same folder
        }
        return write_page(folder, "diagnosis.html", content, LOOPS)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, UndefinedError) as error:
        raise ReportError(
            f"diagnosis.json in {folder.name} cannot be shown, {type(error).__name__}: {error}; run diagnose again"
        ) from error
