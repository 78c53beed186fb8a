#!/usr/bin/env python3
"""FaceTalk's Table 4 and Fig. 9: codes fitted to a sequence of scans, with and without a temporal term.

python scripts/table_facetalk_4.py --data CORPUS [--head DIR] [--size full]
"""

from freetalk.tables.fitting import main

if __name__ == "__main__":
    raise SystemExit(main())
