#!/usr/bin/env python3
"""FaceTalk's Table 2: what the parts of the denoiser are for.

python scripts/table_facetalk_2.py --data CORPUS [--size full]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("facetalk_2"))
