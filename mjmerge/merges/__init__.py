"""Lane changes of recorded traffic as scenarios: written, tightened, run, and the law beside the human."""
