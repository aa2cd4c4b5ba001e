#pragma once
// What can be set of the store. Defaults stand here and nowhere else.

#include <string>

namespace zloam::store {

struct StoreConfig {
  /// folder of the log
  std::string path = "out/tiles";
  int sync_ms = 1000;
  int sync_mib = 8;
  int segment_mib = 64;
  /// compaction above this size of the log, and
  int compact_mib = 256;
  /// when the log is so many times what still holds
  double garbage_factor = 3.0;
};

}  // namespace zloam::store
