#!/usr/bin/env python3
"""FaceTalk's Table 1: whole systems by rendered mouths and by lips.

python scripts/table_facetalk_1.py --data CORPUS [--features INCEPTION] [--syncnet FILE] [--score FIQA=module:function]
"""

from freetalk.tables.systems import main

if __name__ == "__main__":
    raise SystemExit(main())
