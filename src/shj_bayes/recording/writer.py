"""Our own recordings as text: three columns in s, mm and kN."""

from pathlib import Path

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.recording import Recording


def write_csv(path: str | Path, recording: Recording, comment: str = "", digits: int = 7) -> Path:
    """Write a recording as ``time_s,displacement_mm,force_kN``; an existing file is replaced.

    Findings are not written: reading the file checks it anew. The comment stands above the header, each line after
    ``#``; a line with the word SIMULATED makes the reader say so. Displacement and force have 3 to 17 significant
    digits, time 12 at least. `RecordingError` where the digits are out of range or the file cannot be written.
    """
    path = Path(path)
    if not 3 <= digits <= 17:
        raise RecordingError(f"digits = {digits}: allowed is 3 to 17 (17 keep every bit)")
    rows = np.column_stack([recording.time_s, recording.displacement_mm, recording.force_kN])
    header = "".join(f"# {line}\n" for line in comment.splitlines()) + "time_s,displacement_mm,force_kN\n"
    try:
        with path.open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(header)
            np.savetxt(stream, rows, fmt=[f"%.{max(12, digits)}g", f"%.{digits}g", f"%.{digits}g"], delimiter=",")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error
    return path
