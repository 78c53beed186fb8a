// Where results that can be made again are kept.
#pragma once

#include <filesystem>

namespace freetalk::core {

/// $FREETALK_CACHE, or $XDG_CACHE_HOME/freetalk, or ~/.cache/freetalk; in the system's temporary
/// folder where there is no home. Read anew at each call; the folder need not exist.
std::filesystem::path default_cache_dir();

}  // namespace freetalk::core
