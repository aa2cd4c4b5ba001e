#include "store/store_parameters.hpp"

namespace zloam::store {

using runtime::Effect;

void bind(runtime::Parameters& p, StoreConfig& c) {
  p.add("store.path", &c.path, "folder of the tiles", Effect::kNone);
  p.add("store.sync_ms", &c.sync_ms, {10, 60000}, "ms",
        "maximum time between syncs to disk, and so of data lost at a power failure",
        Effect::kNone);
  p.add("store.sync_mib", &c.sync_mib, {1, 1024}, "MiB",
        "maximum of unsynced data, and so of data lost at a power failure", Effect::kNone);
}

}  // namespace zloam::store
