"""Six assignments and a project on the paper: release them to students, grade what comes back.

    python -m course release hw1 --out students/hw1
    python -m course grade hw1 submissions --csv grades.csv

docs/instructors.md is the manual.  Every assignment is a folder::

    hw1/handout.md     what to do; its table of points is the one that the grader reads
    hw1/source/        one marked source: what stands between BEGIN and END SOLUTION is taken out
    hw1/tests/         public tests, which students get
    hw1/hidden/        tests that they do not get
"""

import agility_ref  # noqa: F401  (sets up the numerical libraries, so before numpy)
