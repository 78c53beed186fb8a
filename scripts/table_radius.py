#!/usr/bin/env python3
"""A sweep of the radius of the band of ATS's cross-attention, which FreeTalk leaves open.

python scripts/table_radius.py --data CORPUS [--size full] [--settings 0 3 1000]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("radius"))
