#!/usr/bin/env python3
"""FreeTalk's supplementary Table 2: how STM joins landmarks and mesh.

python scripts/table_supp_2.py --data CORPUS [--size full]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("supp_2"))
