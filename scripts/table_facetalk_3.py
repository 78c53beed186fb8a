#!/usr/bin/env python3
"""FaceTalk's Table 3: weights of expressions and codes of a head, with and without diffusion.

python scripts/table_facetalk_3.py --data CORPUS [--size full] [--settings weights head]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("facetalk_3"))
