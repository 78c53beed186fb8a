// Compiles the shared precompiled header once; the rooms reuse it.
