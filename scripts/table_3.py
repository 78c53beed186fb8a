#!/usr/bin/env python3
"""FreeTalk's Table 3: neutral speech to meshes, by what each stage was trained on.

python scripts/table_3.py --data CORPUS [--size full] [--settings '3,4,5+3,4,5' ...] [--pred NAME=DIR ...]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("table_3"))
