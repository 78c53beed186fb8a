#!/usr/bin/env python3
"""FreeTalk's supplementary Table 1: STM's extractor x decoder.

python scripts/table_supp_1.py --data CORPUS [--size full]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("supp_1"))
