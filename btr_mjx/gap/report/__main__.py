"""Draw the pages of diagnoses again: `python -m btr_mjx.gap.report runs/diagnosis-0`."""

from btr_mjx.gap.report.page import main

if __name__ == "__main__":
    main()
