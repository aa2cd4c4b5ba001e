// The tile store on a full disk.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <system_error>
#include <vector>

#include "common/geometry/test_file_limit.hpp"
#include "common/geometry/test_folder.hpp"
#include "store/tile_store.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;

class FullDisk : public InFolder {
 protected:
};

StoredMessage message(const std::string& key, std::size_t bytes) {
  return {"loam/r/map/tile/" + key, "flat", {1, 1, 1}, std::vector<std::uint8_t>(bytes, 7)};
}

TEST_F(FullDisk, ACompactionThatFindsNoRoomLeavesIt) {
  StoreLimits limits;
  // A segment for each record, so that only the compaction writes a long file.
  limits.log.segment_bytes = 1000;
  TileStore store(folder_, limits);
  for (const char* key : {"a", "b", "c"}) store.put(message(key, 1000));
  {
    const FileLimit limit(2000);
    EXPECT_THROW(store.compact(), std::system_error);
    EXPECT_FALSE(fs::exists(folder_ / "compaction.tmp"));
    store.put(message("d", 1000));
  }
  EXPECT_EQ(store.get("loam/r/map/tile/a")->payload.size(), 1000U);
  store.compact();
  EXPECT_EQ(TileStore(folder_, limits, Access::kRead).keys().size(), 4U);
}

// As on a disk that fails: the next start would set the segments behind that record aside.
TEST_F(FullDisk, NothingIsWrittenBehindAHalfWrittenRecordThatCannotBeCutOff) {
  LogLimits limits;
  limits.segment_bytes = 100;
  RecordLog log(folder_, limits, [](std::span<const std::uint8_t>, const Place&) {});
  const std::vector<std::uint8_t> body(100, 7);
  log.append(body);
  // The next segment is a file that never shrinks.
  const int sealed = ::memfd_create("segment", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  ASSERT_EQ(::fcntl(sealed, F_ADD_SEALS, F_SEAL_SHRINK), 0);
  fs::create_symlink("/proc/self/fd/" + std::to_string(sealed), folder_ / "00000002.log");
  {
    const FileLimit limit(50);
    EXPECT_THROW(log.append(body), std::system_error);
  }
  for (int i = 0; i < 3; ++i) EXPECT_THROW(log.append(body), std::system_error);
  EXPECT_FALSE(fs::exists(folder_ / "00000003.log"));
  EXPECT_EQ(fs::file_size(folder_ / "00000002.log"), 50U);
  ::close(sealed);
}

// The store tries again each second.
TEST_F(FullDisk, ACompactionThatNeedsMoreRoomThanThereIsWritesNothing) {
  RecordLog log(folder_, {}, [](std::span<const std::uint8_t>, const Place&) {});
  const std::uint64_t before = changes();
  bool is_asked = false;
  try {
    log.compact(std::uint64_t{1} << 60, [&](const auto&) { is_asked = true; });
    ADD_FAILURE() << "done without room";
  } catch (const std::system_error& e) {
    EXPECT_EQ(e.code(), std::errc::no_space_on_device);
    EXPECT_NE(std::string(e.what()).find(folder_.string()), std::string::npos) << e.what();
  }
  EXPECT_FALSE(is_asked);
  EXPECT_EQ(changes(), before);
}

// Otherwise a store on a tmpfs without a limit would never compact.
TEST(Room, AFileSystemThatReportsNoSizeMayHaveRoom) {
  EXPECT_TRUE(may_have_room({0, 0, 0}, 1000));
  EXPECT_FALSE(may_have_room({5000, 0, 0}, 1000));
  EXPECT_FALSE(may_have_room({5000, 999, 999}, 1000));
  EXPECT_TRUE(may_have_room({5000, 1000, 1000}, 1000));
  EXPECT_EQ(may_have_room({5000, 1000, 500}, 1000), ::geteuid() == 0) << "a reserve for root";
}

}  // namespace
}  // namespace zloam::store
