#include "core/scratch.h"

#include <ATen/ATen.h>
#include <fcntl.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "freetalk/core/log.h"

namespace freetalk::core {
namespace {

struct ScratchMapping {
  void* data;
  size_t bytes;
};

void unmap(void* context) {
  auto* mapping = static_cast<ScratchMapping*>(context);
  ::munmap(mapping->data, mapping->bytes);
  delete mapping;
}

/// A file of `bytes` without a name, its blocks allocated; -1 where there is no room for it.
int temporary_file(int64_t bytes, std::filesystem::path folder) {
  std::error_code failed;
  if (folder.empty()) folder = std::filesystem::temp_directory_path(failed);
  if (failed) return -1;
  std::string name = (folder / "freetalk-XXXXXX").string();
  const int file = ::mkstemp(name.data());
  if (file < 0) return -1;
  ::unlink(name.c_str());
  if (::posix_fallocate(file, 0, bytes) == 0) return file;
  ::close(file);
  return -1;
}

}  // namespace

at::Tensor scratch_tensor(at::IntArrayRef sizes, int64_t threshold_bytes,
                          const std::filesystem::path& folder) {
  const int64_t bytes = c10::multiply_integers(sizes) * static_cast<int64_t>(sizeof(float));
  if (bytes < threshold_bytes || bytes == 0) return at::empty(sizes, at::kFloat);
  const int file = temporary_file(bytes, folder);
  if (file < 0) {
    log(LogLevel::kWarning, "no temporary file of " + std::to_string(bytes >> 20) + " MB in '" +
                                folder.string() + "': the result lies in memory");
    return at::empty(sizes, at::kFloat);
  }
  const auto size = static_cast<size_t>(bytes);
  void* data = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (data == MAP_FAILED) return at::empty(sizes, at::kFloat);
  c10::DataPtr pointer(data, new ScratchMapping{data, size}, &unmap, at::kCPU);
  const c10::Storage storage(c10::Storage::use_byte_size_t(), size, std::move(pointer));
  return at::empty({0}, at::kFloat).set_(storage, 0, sizes);
}

void release_pages(const at::Tensor& tensor) {
  if (!tensor.defined() || !tensor.device().is_cpu() || !tensor.is_contiguous()) return;
  if (tensor.storage().data_ptr().get_deleter() != &unmap) return;
  const auto page = static_cast<uintptr_t>(::sysconf(_SC_PAGESIZE));
  const auto first = reinterpret_cast<uintptr_t>(tensor.data_ptr());
  const uintptr_t start = first / page * page;
  ::madvise(reinterpret_cast<void*>(start), first - start + tensor.nbytes(), MADV_DONTNEED);
}

void give_memory_back() {
#ifdef __GLIBC__
  ::malloc_trim(0);
#endif
}

}  // namespace freetalk::core
