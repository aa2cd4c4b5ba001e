#include "store/store_parameters.hpp"

namespace zloam::store {

using runtime::Effect;

void bind(runtime::Parameters& p, StoreConfig& c) {
  p.add("store.path", &c.path, "folder of the tiles", Effect::kNone);
  p.add("store.sync_ms", &c.sync_ms, {10, 60000}, "ms",
        "written to the disk's platter at least so often: a power failure loses no more",
        Effect::kNone);
  p.add("store.sync_mib", &c.sync_mib, {1, 1024}, "MiB", "and after so much", Effect::kNone);
  p.add("store.segment_mib", &c.segment_mib, {1, 4096}, "MiB", "size of one file of the log",
        Effect::kNone);
  p.add("store.compact_mib", &c.compact_mib, {1, 1 << 20}, "MiB", "a smaller log is not compacted",
        Effect::kNone);
  p.add("store.garbage_factor", &c.garbage_factor, {1.1, 100.0}, "",
        "a log of so many times what still holds is compacted", Effect::kNone);
}

}  // namespace zloam::store
