// Earlier maps against what was put before each of them, and kills at any change of the disk.

#include "store/earlier_maps.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <set>

#include "common/geometry/test_folder.hpp"
#include "store/generation.hpp"
#include "store/tile_store.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;

class EarlierMaps : public InFolder {
 protected:
  /// Folders in the store's folder.
  std::set<std::string> folders() const {
    std::set<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder_)) {
      if (entry.is_directory()) names.insert(entry.path().filename().string());
    }
    return names;
  }
  std::optional<fs::path> keep(TileStore& store) const {
    return keep_earlier_map(folder_, store.close_files());
  }
};

StoredMessage message(const std::string& key, std::uint64_t map, std::uint64_t version = 1) {
  const auto fill = static_cast<std::uint8_t>(31 * version + map);
  return {key, "flat", {map, 1, version}, std::vector<std::uint8_t>(40, fill)};
}

/// As a user names it for store.path.
std::vector<std::string> keys_in(const fs::path& folder) {
  const TileStore store(folder, {});
  EXPECT_FALSE(store.recovery().damaged) << store.recovery().missing;
  return store.keys();
}

void change_a_byte(const fs::path& path, std::streamoff at) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(at);
  file.put('\x55');
}

TEST_F(EarlierMaps, OneIsWholeAfterTheNextMapWasCompacted) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  TileStore store(folder_, small);
  for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
  store.compact();
  for (const char* key : {"d", "e"}) store.put(message(key, 1));
  store.put(message("a", 1, 2));
  const auto kept = keep(store);
  ASSERT_EQ(kept, folder_ / "earlier-1");
  store.put(message("f", 2));
  EXPECT_THAT(keys_in(*kept), ElementsAre("a", "b", "c", "d", "e")) << "nothing of the next map";
  store.compact();
  {
    TileStore earlier(*kept, small);
    EXPECT_FALSE(earlier.recovery().damaged) << earlier.recovery().missing;
    EXPECT_THAT(earlier.keys(), ElementsAre("a", "b", "c", "d", "e"));
    EXPECT_EQ(earlier.get("a")->payload, message("a", 1, 2).payload);
    for (const char* key : {"b", "c", "d", "e"}) {
      EXPECT_EQ(earlier.get(key)->payload, message(key, 1).payload);
    }
    earlier.put(message("g", 1));
    earlier.compact();
  }
  EXPECT_THAT(store.keys(), ElementsAre("f"));
  EXPECT_EQ(store.get("f")->payload, message("f", 2).payload);
  EXPECT_THAT(folders(), ElementsAre("earlier-1"));
}

TEST_F(EarlierMaps, NothingThatHasSuchANameIsReplaced) {
  fs::create_directory(folder_ / "earlier-2");
  { TileStore(folder_ / "earlier-2", {}).put(message("other", 7)); }
  std::ofstream(folder_ / "earlier-4") << "a file";
  TileStore store(folder_, {});
  store.put(message("a", 1));
  EXPECT_EQ(keep(store), folder_ / "earlier-5");
  EXPECT_FALSE(remove_oldest_map(folder_));
  EXPECT_THAT(keys_in(folder_ / "earlier-2"), ElementsAre("other"));
  EXPECT_TRUE(fs::is_regular_file(folder_ / "earlier-4"));
}

// Its number is that of the current map in the folder, which begins again with what a user restores.
TEST_F(EarlierMaps, ARestoredMapReplacesNoLaterOne) {
  for (const std::uint64_t run : {1U, 2U}) {
    TileStore store(folder_, {});
    Generations maps(store);
    maps.begin(run, 0);
    store.put(message(run == 1 ? "monday" : "tuesday", maps.current()));
    keep(store);
  }
  for (const char* file : {"00000001.log", "00000002.log", "00000003.log", "00000004.log"}) {
    ASSERT_TRUE(fs::remove(folder_ / file));
  }
  fs::copy_file(folder_ / "earlier-1" / "00000001.log", folder_ / "00000001.log");
  TileStore store(folder_, {});
  Generations maps(store);
  ASSERT_EQ(maps.current(), 1U);
  maps.begin(3, 0);
  store.put(message("wednesday", maps.current()));
  EXPECT_EQ(keep(store), folder_ / "earlier-3");
  EXPECT_THAT(keys_in(folder_ / "earlier-2"), ElementsAre("#map", "tuesday"));
}

TEST_F(EarlierMaps, TheFourthRemovesTheOldest) {
  fs::create_directory(folder_ / "earlier-monday");
  TileStore store(folder_, {});
  for (std::uint64_t map = 1; map <= 4; ++map) {
    store.put(message("map " + std::to_string(map), map));
    keep(store);
    EXPECT_EQ(remove_oldest_map(folder_),
              map < 4 ? std::nullopt : std::optional(folder_ / "earlier-1"));
  }
  EXPECT_THAT(folders(), ElementsAre("earlier-2", "earlier-3", "earlier-4", "earlier-monday"));
  EXPECT_THAT(keys_in(folder_ / "earlier-2"), ElementsAre("map 2"));
  EXPECT_THAT(keys_in(folder_ / "earlier-4"), ElementsAre("map 4"));
}

TEST_F(EarlierMaps, OneThatAnotherStoreUsesIsNotRemoved) {
  TileStore store(folder_, {});
  for (std::uint64_t map = 1; map <= 4; ++map) {
    store.put(message("a", map));
    keep(store);
  }
  {
    const TileStore user(folder_ / "earlier-1", {});
    EXPECT_THROW(remove_oldest_map(folder_), std::system_error);
    EXPECT_EQ(folders().size(), 4U);
  }
  EXPECT_EQ(remove_oldest_map(folder_), folder_ / "earlier-1");
}

TEST_F(EarlierMaps, AMapIsKeptOnceHoweverOftenTheNextOneIsBegun) {
  {
    TileStore store(folder_, {});
    store.put(message("a", 1));
    EXPECT_EQ(keep(store), folder_ / "earlier-1");
    EXPECT_FALSE(keep(store));
  }
  TileStore store(folder_, {});
  EXPECT_FALSE(keep(store)) << "after a start";
  store.put(message("b", 1));
  EXPECT_EQ(keep(store), folder_ / "earlier-2");
  EXPECT_THAT(keys_in(folder_ / "earlier-2"), ElementsAre("a", "b"));
}

TEST_F(EarlierMaps, OneThatCantBeLinkedLeavesNothing) {
  TileStore store(folder_, {});
  store.put(message("a", 1));
  std::vector<fs::path> files = store.close_files();
  files.push_back(folder_ / "00000007.log");
  EXPECT_THROW(keep_earlier_map(folder_, files), std::system_error);
  EXPECT_THROW(keep_earlier_map(folder_, {}), std::system_error);
  EXPECT_THAT(folders(), testing::IsEmpty());
  EXPECT_EQ(store.put(message("b", 2)), PutResult::kStored);
}

// Nothing is read for it.
TEST_F(EarlierMaps, ARecordThatCantBeReadIsNoObstacle) {
  TileStore store(folder_, {});
  store.put(message("a", 1));
  store.put(message("b", 1));
  fs::resize_file(folder_ / "00000001.log", 80);
  EXPECT_THROW(store.get("b"), std::system_error);
  ASSERT_EQ(keep(store), folder_ / "earlier-1");
  EXPECT_THAT(TileStore(folder_ / "earlier-1", {}, Access::kRead).keys(), ElementsAre("a"));
  EXPECT_EQ(store.put(message("c", 2)), PutResult::kStored);
}

// A bad record in a file that both have: where it is cut off first, the other says it, too.
TEST_F(EarlierMaps, DamageOfASharedFileIsSaidByBoth) {
  {
    TileStore store(folder_, {});
    for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
    keep(store);
  }
  // In the body of the second of three records of like sizes.
  const fs::path shared = folder_ / "00000001.log";
  change_a_byte(shared, static_cast<std::streamoff>(fs::file_size(shared) * 2 / 3 - 5));
  for (const fs::path& folder : {folder_, folder_ / "earlier-1"}) {
    const TileStore store(folder, {});
    EXPECT_TRUE(store.recovery().damaged) << folder;
    EXPECT_THAT(store.keys(), ElementsAre("a")) << folder;
  }
}

/// The work of the child process.
[[noreturn]] void work(const fs::path& folder, std::uint64_t die_at) {
  die_at_change(die_at);
  TileStore store(folder, {});
  for (std::uint64_t map = 1; map <= kEarlierMaps + 1; ++map) {
    store.put(message("a", map));
    store.put(message("b", map));
    keep_earlier_map(folder, store.close_files());
    remove_oldest_map(folder);
  }
  _exit(0);
}

/// Whether the work was killed at this change of the disk.
bool is_killed_at(const fs::path& folder, std::uint64_t die_at) {
  const pid_t child = fork();
  if (child == 0) work(folder, die_at);
  int status = 0;
  waitpid(child, &status, 0);
  const bool killed = WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL;
  EXPECT_TRUE(killed || (WIFEXITED(status) && WEXITSTATUS(status) == 0)) << die_at;
  return killed;
}

TEST_F(EarlierMaps, EachIsWholeOrNotThereAfterAKillAtAnyChange) {
  for (std::uint64_t die_at = 1;; ++die_at) {
    const fs::path folder = folder_ / std::to_string(die_at);
    const bool killed = is_killed_at(folder, die_at);
    TileStore store(folder, {});
    store.put(message("a", kEarlierMaps + 2));
    EXPECT_TRUE(keep_earlier_map(folder, store.close_files())) << die_at;
    remove_oldest_map(folder);
    std::size_t maps = 0;
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (!entry.is_directory()) continue;
      ++maps;
      EXPECT_TRUE(entry.path().filename().string().starts_with("earlier-")) << entry.path();
      EXPECT_FALSE(keys_in(entry.path()).empty()) << die_at << " " << entry.path();
    }
    EXPECT_GE(maps, 1U);
    fs::remove_all(folder);
    if (killed) continue;
    EXPECT_EQ(maps, kEarlierMaps);
    EXPECT_GT(die_at, 30U) << "links, renames and a removal were all hit";
    break;
  }
}

}  // namespace
}  // namespace zloam::store
