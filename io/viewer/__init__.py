"""The only folder that knows rerun."""

import os

# What goes wrong is said by ourselves, in one sentence; rerun reads this while it is imported.
os.environ.setdefault("RUST_LOG", "off")
