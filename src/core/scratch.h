// Large tensors that lie in a temporary file instead of the process's memory.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>

namespace freetalk::core {

/// An uninitialised float32 CPU tensor. From `threshold_bytes` on it is the mapping of a temporary
/// file without a name in `folder`, which goes with the tensor; where none can be made, or the disk
/// is full, it lies in memory as any other, and the log says so.
/// @param folder empty: the system's temporary folder.
at::Tensor scratch_tensor(at::IntArrayRef sizes, int64_t threshold_bytes = int64_t{64} << 20,
                          const std::filesystem::path& folder = {});

/// Takes the pages of a scratch tensor, or of a contiguous part of one, out of the process's
/// memory; the values stay and are read again when touched. Other tensors are left alone.
void release_pages(const at::Tensor& tensor);

/// Returns what was freed to the system: glibc keeps it otherwise, for each thread that worked.
void give_memory_back();

}  // namespace freetalk::core
