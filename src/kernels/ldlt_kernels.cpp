#include "kernels/ldlt_kernels.h"

#include "kernels/isa.h"

namespace freetalk::kernels {
namespace {

#define FREETALK_BODY "kernels/ldlt_kernels.inc"
#include "kernels/each_isa.inc"

}  // namespace

const LdltKernels& ldlt_kernels() { return for_isa(isa()); }

}  // namespace freetalk::kernels
