#!/usr/bin/env python3
"""FaceTalk's Table 5: how the diffusion step is told to the denoiser.

python scripts/table_facetalk_5.py --data CORPUS [--size full]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("facetalk_5"))
