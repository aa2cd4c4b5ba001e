// The tile store against cuts at any byte, kills at any change of the disk, and a model in memory.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <map>
#include <random>

#include "common/geometry/test_folder.hpp"
#include "store/crc32c.hpp"
#include "store/tile_store.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;

class Store : public InFolder {
 protected:
};

StoredMessage message(const std::string& key, std::uint64_t version, std::size_t size = 40) {
  StoredMessage m{"loam/r/map/tile/" + key, "flat", {1, 1, version}, {}};
  for (std::size_t i = 0; i < size; ++i) {
    m.payload.push_back(static_cast<std::uint8_t>(version * 31 + i * 7 + key[0]));
  }
  return m;
}

/// Segments that hold records, ascending.
std::vector<fs::path> filled_segments(const fs::path& folder) {
  std::vector<fs::path> filled;
  for (const auto& e : fs::directory_iterator(folder)) {
    if (e.path().extension() == ".log" && e.file_size() > 0) filled.push_back(e.path());
  }
  std::sort(filled.begin(), filled.end());
  return filled;
}

fs::path last_segment(const fs::path& folder) { return filled_segments(folder).back(); }

std::vector<std::uint8_t> bytes_of(std::string_view text) { return {text.begin(), text.end()}; }

// RFC 3720, appendix B.4, and the check value of the catalogue of CRC algorithms (CRC-32/ISCSI).
TEST(Crc32c, KnownVectors) {
  EXPECT_EQ(crc32c(bytes_of("123456789")), 0xE3069283U);
  EXPECT_EQ(crc32c(std::vector<std::uint8_t>(32, 0x00)), 0x8A9136AAU);
  EXPECT_EQ(crc32c(std::vector<std::uint8_t>(32, 0xFF)), 0x62A8AB43U);
  std::vector<std::uint8_t> ascending;
  for (int i = 0; i < 32; ++i) ascending.push_back(static_cast<std::uint8_t>(i));
  EXPECT_EQ(crc32c(ascending), 0x46DD794EU);
  EXPECT_EQ(crc32c({}), 0U);
}

TEST_F(Store, TwoProcessesDoNotWriteIntoOneFolder) {
  TileStore store(folder_ / "s", {});
  store.put(message("a", 1));
  try {
    TileStore second(folder_ / "s", {});
    FAIL() << "opened twice";
  } catch (const std::system_error& e) {
    EXPECT_THAT(e.what(), testing::HasSubstr("is in use by another store"));
  }
  // Reading changes nothing, also while a record is being written.
  std::ofstream(last_segment(folder_ / "s"), std::ios::app) << "half a rec";
  const auto size = fs::file_size(last_segment(folder_ / "s"));
  EXPECT_EQ(TileStore(folder_ / "s", {}, Access::kRead).keys().size(), 1U);
  EXPECT_EQ(fs::file_size(last_segment(folder_ / "s")), size);
}

TEST_F(Store, TheGreatestRankWinsWhateverTheOrder) {
  std::vector<Rank> ranks = {{1, 1, 5}, {1, 1, 4}, {1, 2, 1}, {1, 1, 9}, {1, 2, 2}};
  std::sort(ranks.begin(), ranks.end());
  do {
    fs::remove_all(folder_ / "s");
    TileStore store(folder_ / "s", {});
    for (const Rank& rank : ranks) {
      StoredMessage m = message("a", rank.version);
      m.rank = rank;
      store.put(m);
    }
    ASSERT_EQ(store.rank("loam/r/map/tile/a"), (Rank{1, 2, 2}));
    ASSERT_EQ(TileStore(folder_ / "s", {}, Access::kRead).get("loam/r/map/tile/a")->payload,
              message("a", 2).payload);
  } while (std::next_permutation(ranks.begin(), ranks.end()));
}

TEST_F(Store, ANewMapPutsTheOldOneAway) {
  {
    TileStore store(folder_, {});
    store.put(message("a", 7));
    store.put(message("b", 8));
    StoredMessage next = message("c", 1);
    next.rank.map_id = 2;
    EXPECT_EQ(store.put(next), PutResult::kStored);
    EXPECT_THAT(store.keys(), ElementsAre(next.key));
    EXPECT_EQ(store.put(message("a", 99)), PutResult::kOld);
    store.compact();
  }
  TileStore again(folder_, {});
  EXPECT_EQ(again.newest_map(), 2U);
  EXPECT_EQ(again.keys().size(), 1U);
  EXPECT_EQ(again.recovery().records, 1U) << "the old map's records are gone from the disk";
}

TEST_F(Store, CutAtEveryByteKeepsAllRecordsBefore) {
  std::vector<std::uint64_t> ends = {0};
  {
    TileStore store(folder_ / "whole", {});
    for (std::uint64_t v = 1; v <= 5; ++v) {
      store.put(message(std::string(1, static_cast<char>('a' + v)), v, 20 + 3 * v));
      ends.push_back(store.log_bytes());
    }
  }
  const std::vector<std::uint8_t> whole = ReadFile(last_segment(folder_ / "whole")).all();
  ASSERT_EQ(whole.size(), ends.back());
  for (std::size_t cut = 0; cut <= whole.size(); ++cut) {
    const fs::path folder = folder_ / "cut";
    fs::remove_all(folder);
    fs::create_directories(folder);
    std::ofstream(folder / "00000001.log", std::ios::binary)
        .write(reinterpret_cast<const char*>(whole.data()), static_cast<std::streamsize>(cut));
    const auto complete = static_cast<std::size_t>(std::upper_bound(ends.begin(), ends.end(), cut) -
                                                   ends.begin() - 1);
    {
      TileStore store(folder, {});
      ASSERT_EQ(store.keys().size(), complete) << "cut at " << cut;
      ASSERT_EQ(store.recovery().cut_bytes, cut - ends[complete]);
      ASSERT_FALSE(store.recovery().damaged) << "cut at " << cut;
      for (std::size_t v = 1; v <= complete; ++v) {
        const StoredMessage m = message(std::string(1, static_cast<char>('a' + v)), v, 20 + 3 * v);
        ASSERT_EQ(store.get(m.key)->payload, m.payload);
      }
      store.put(message("z", 1));
    }
    ASSERT_EQ(TileStore(folder, {}).keys().size(), complete + 1) << "what comes after is kept";
  }
}

TEST_F(Store, AFlippedBitEndsTheLogThere) {
  {
    TileStore store(folder_, {});
    for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
  }
  const fs::path segment = last_segment(folder_);
  const std::vector<std::uint8_t> whole = ReadFile(segment).all();
  const std::size_t record = whole.size() / 3;
  // A record that seems to be longer than the file looks like one that a kill cut short, and so does
  // the last record.
  const auto could_be_a_kill = [record](std::size_t at) {
    return at % record < 4 || at >= 2 * record;
  };
  for (std::size_t at = 0; at < whole.size(); ++at) {
    const fs::path folder = folder_ / "flipped";
    fs::remove_all(folder);
    fs::create_directories(folder);
    std::vector<std::uint8_t> bad = whole;
    bad[at] ^= 0x10;
    std::ofstream(folder / "00000001.log", std::ios::binary)
        .write(reinterpret_cast<const char*>(bad.data()), static_cast<std::streamsize>(bad.size()));
    bool damaged = false;
    {
      const TileStore store(folder, {});
      damaged = store.recovery().damaged;
      ASSERT_EQ(store.keys().size(), at / record) << at;
    }
    ASSERT_TRUE(damaged || could_be_a_kill(at)) << at;
    ASSERT_EQ(damaged, fs::exists(folder / "00000001.log.ignored")) << at;
    ASSERT_EQ(damaged, TileStore(folder, {}).recovery().damaged) << "a later start says so, too";
  }
}

// A disk that fails while the store runs. A compaction would give what is damaged a new checksum.
TEST_F(Store, WhatIsDamagedAfterTheStartIsNeitherReadNorCompacted) {
  TileStore store(folder_, {});
  for (const char* key : {"a", "b"}) store.put(message(key, 1));
  const fs::path segment = last_segment(folder_);
  {
    std::fstream file(segment, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(-1, std::ios::end);
    file.put('\0');
  }
  EXPECT_EQ(store.get(message("a", 1).key)->payload, message("a", 1).payload);
  EXPECT_THROW(store.get(message("b", 1).key), std::system_error);
  EXPECT_THROW(store.compact(), std::system_error);
  EXPECT_TRUE(fs::exists(segment)) << "as evidence";
  EXPECT_EQ(store.keys().size(), 2U);
  store.put(message("b", 2));
  store.compact();
  EXPECT_EQ(store.get(message("b", 2).key)->payload, message("b", 2).payload);
}

TEST_F(Store, ZerosAfterAPowerFailureAreNoRecords) {
  { TileStore(folder_, {}).put(message("a", 1)); }
  std::ofstream(last_segment(folder_), std::ios::binary | std::ios::app) << std::string(4096, '\0');
  TileStore store(folder_, {});
  EXPECT_EQ(store.keys().size(), 1U);
  EXPECT_EQ(store.recovery().cut_bytes, 4096U);
  EXPECT_FALSE(store.recovery().damaged);
}

TEST_F(Store, ARecordThatAPowerFailureFilledUpWithZerosIsNoDamage) {
  { TileStore(folder_, {}).put(message("a", 1)); }
  const fs::path segment = last_segment(folder_);
  const std::vector<std::uint8_t> record = ReadFile(segment).all();
  std::ofstream(segment, std::ios::binary | std::ios::app)
          .write(reinterpret_cast<const char*>(record.data()),
                 static_cast<std::streamsize>(record.size() / 2))
      << std::string(4096, '\0');
  const TileStore store(folder_, {});
  EXPECT_EQ(store.keys().size(), 1U);
  EXPECT_FALSE(store.recovery().damaged);
}

TEST_F(Store, SegmentsBehindABadRecordAreSetAside) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  {
    TileStore store(folder_, small);
    for (std::uint64_t v = 1; v <= 4; ++v)
      store.put(message(std::string(1, static_cast<char>('a' + v)), v));
  }
  fs::resize_file(folder_ / "00000002.log", 10);
  for (const Access access : {Access::kRead, Access::kWrite}) {
    const TileStore store(folder_, small, access);
    EXPECT_THAT(store.keys(), ElementsAre(message("b", 1).key));
    EXPECT_EQ(store.recovery().ignored_segments, 2U);
    EXPECT_TRUE(store.recovery().damaged);
  }
}

TEST_F(Store, CompactionKeepsWhatHoldsAndNothingElse) {
  StoreLimits small;
  small.log.segment_bytes = 400;
  small.compact_bytes = 2000;
  std::map<std::string, StoredMessage> model;
  std::mt19937 random(7);  // NOLINT: the same each time
  int compactions = 0;
  {
    TileStore store(folder_, small);
    for (std::uint64_t v = 1; v <= 400; ++v) {
      const StoredMessage m =
          message(std::string(1, static_cast<char>('a' + random() % 6)), v, v % 50);
      store.put(m);
      model[m.key] = m;
      compactions += store.compact_if_due() ? 1 : 0;
      ASSERT_LE(store.live_bytes(), store.log_bytes());
    }
    EXPECT_LT(store.log_bytes(), 3000U);
  }
  EXPECT_GT(compactions, 3);
  const TileStore store(folder_, small);
  ASSERT_EQ(store.keys().size(), model.size());
  for (const auto& [key, m] : model) {
    EXPECT_EQ(store.get(key)->payload, m.payload);
    EXPECT_EQ(store.get(key)->encoding, "flat");
  }
}

TEST_F(Store, AReaderKeepsTheMapThatAWriterCompacts) {
  TileStore store(folder_, {});
  for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
  const TileStore reader(folder_, {}, Access::kRead);
  store.put(message("a", 2));
  store.compact();
  ASSERT_FALSE(fs::exists(folder_ / "00000001.log"));
  for (const char* key : {"a", "b", "c"}) {
    EXPECT_EQ(reader.get(message(key, 1).key)->payload, message(key, 1).payload);
  }
}

TEST_F(Store, AFileThatIsMissingIsNamed) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  const auto fill = [&](const fs::path& folder, bool compacted) {
    TileStore store(folder, small);
    for (const char* key : {"a", "b", "c", "d"}) store.put(message(key, 1));
    if (compacted) store.compact();
    for (const char* key : {"e", "f"}) store.put(message(key, 1));
  };
  struct Case {
    const char* removed;
    bool compacted;
    std::size_t left;
  };
  for (const Case& c : {Case{"00000002.log", false, 5}, Case{"00000004.base", true, 2},
                        Case{"00000005.log", true, 5}}) {
    for (const Access access : {Access::kRead, Access::kWrite}) {
      const fs::path folder = folder_ / c.removed / std::to_string(static_cast<int>(access));
      fs::create_directories(folder);
      fill(folder, c.compacted);
      EXPECT_EQ(TileStore(folder, small, Access::kRead).recovery().missing, "");
      ASSERT_TRUE(fs::remove(folder / c.removed));
      const TileStore store(folder, small, access);
      EXPECT_TRUE(store.recovery().damaged);
      EXPECT_EQ(store.recovery().missing, c.removed);
      EXPECT_EQ(store.recovery().missing_files, 1U);
      EXPECT_EQ(store.keys().size(), c.left);
    }
  }
}

TEST_F(Store, AFolderThatLacksAFileIsWholeAgainWithANewMap) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  {
    TileStore store(folder_, small);
    for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
  }
  ASSERT_TRUE(fs::remove(folder_ / "00000002.log"));
  StoredMessage next = message("a", 1);
  {
    TileStore store(folder_, small);
    store.put(message("d", 1));
    EXPECT_FALSE(store.compact_if_due()) << "the map that lacks a part is still there";
    next.rank.map_id = 2;
    store.put(next);
    EXPECT_TRUE(store.compact_if_due());
    EXPECT_FALSE(store.recovery().damaged);
    EXPECT_EQ(store.recovery().missing, "");
    EXPECT_FALSE(store.compact_if_due());
  }
  const TileStore store(folder_, small, Access::kRead);
  EXPECT_FALSE(store.recovery().damaged) << store.recovery().missing;
  EXPECT_THAT(store.keys(), ElementsAre(next.key));
}

TEST_F(Store, ARecordOfALaterVersionIsCountedUntilAnotherMapReplacesIt) {
  {
    std::vector<std::uint8_t> body = pack(message("a", 1));
    body.front() = 0xFF;
    RecordLog(folder_, {}, [](std::span<const std::uint8_t>, const Place&) {}).append(body);
  }
  TileStore store(folder_, {});
  EXPECT_EQ(store.unreadable(), 1U);
  EXPECT_TRUE(store.keys().empty());
  store.put(message("b", 1));
  store.compact();
  EXPECT_EQ(store.unreadable(), 0U);
  EXPECT_EQ(TileStore(folder_, {}, Access::kRead).unreadable(), 0U);
}

TEST_F(Store, TheNumberOfAFileThatWasSetAsideIsUsedAgain) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  {
    TileStore store(folder_, small);
    for (const char* key : {"a", "b", "c"}) store.put(message(key, 1));
  }
  fs::resize_file(folder_ / "00000001.log", 10);
  TileStore(folder_, small).put(message("d", 1));
  // As the store advises.
  for (const char* number : {"00000002", "00000003"}) {
    ASSERT_TRUE(fs::remove(folder_ / (std::string(number) + ".log.ignored")));
  }
  const TileStore store(folder_, small);
  EXPECT_FALSE(store.recovery().damaged) << store.recovery().missing;
  EXPECT_THAT(store.keys(), ElementsAre(message("d", 1).key));
}

TEST_F(Store, WhatAnEarlierDamageLeftIsNotReplaced) {
  StoreLimits small;
  small.log.segment_bytes = 200;
  std::map<std::string, std::vector<std::uint8_t>> left;
  for (const std::uint64_t version : {1U, 2U}) {
    {
      TileStore store(folder_, small);
      for (const char* key : {"a", "b", "c", "d", "e", "f", "g", "h"}) {
        store.put(message(key, version));
      }
    }
    // In the first of two records, before the three other segments.
    const fs::path first = filled_segments(folder_).front();
    std::fstream file(first, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(50);
    file.put('\0');
    file.close();
    EXPECT_TRUE(TileStore(folder_, small).keys().empty());
    for (const auto& entry : fs::directory_iterator(folder_)) {
      if (entry.path().extension() != ".ignored") continue;
      const std::vector<std::uint8_t> bytes = ReadFile(entry.path()).all();
      const auto [known, is_new] = left.try_emplace(entry.path().filename().string(), bytes);
      EXPECT_EQ(known->second, bytes) << entry.path();
    }
    EXPECT_EQ(left.size(), 4 * version);
    EXPECT_EQ(TileStore(folder_, small, Access::kRead).recovery().ignored_segments, 4 * version);
  }
}

// A folder where the next segment should be: it can't be created, as on a full disk.
TEST_F(Store, WhatIsStoredAfterASegmentCouldNotBeCreatedIsReadable) {
  StoreLimits small;
  small.log.segment_bytes = 200;
  TileStore store(folder_, small);
  store.put(message("a", 1));
  fs::create_directory(folder_ / "00000002.log");
  EXPECT_THROW(store.put(message("b", 1, 150)), std::system_error);
  store.put(message("c", 1, 0));
  EXPECT_EQ(store.get(message("c", 1).key)->payload.size(), 0U);
  store.compact();
  EXPECT_THROW(store.put(message("b", 1, 150)), std::system_error);
  fs::remove(folder_ / "00000002.log");
  store.put(message("b", 1, 150));
  store.compact();
  store.put(message("d", 1));
  for (const char* key : {"a", "d"}) {
    EXPECT_EQ(store.get(message(key, 1).key)->payload, message(key, 1).payload);
  }
  EXPECT_EQ(store.get(message("b", 1).key)->payload, message("b", 1, 150).payload);
  const TileStore again(folder_, small, Access::kRead);
  EXPECT_EQ(again.keys().size(), 4U);
  EXPECT_FALSE(again.recovery().damaged) << again.recovery().missing;
}

// A device that takes all bytes and can't be synced. Each segment holds one record, so the store
// syncs it when it opens the next one, before anybody asks it to.
TEST_F(Store, WhatCouldNotBeSyncedIsKnownWhoeverNeededIt) {
  StoreLimits small;
  small.log.segment_bytes = 100;
  TileStore store(folder_, small);
  store.put(message("a", 1));
  fs::create_symlink("/dev/null", folder_ / "00000002.log");
  store.put(message("b", 1));
  EXPECT_EQ(store.sync_error(), "");
  EXPECT_THROW(store.put(message("c", 1)), std::system_error);
  EXPECT_THAT(store.sync_error(), testing::HasSubstr("00000002.log"));
}

constexpr int kPuts = 30;
constexpr int kCompactAt = 15;

/// The work of the child process; it reports each completed put through the pipe.
void work(const fs::path& folder, std::uint64_t die_at, int pipe) {
  die_at_change(die_at);
  StoreLimits small;
  small.log.segment_bytes = 300;
  TileStore store(folder, small);
  for (int v = 1; v <= kPuts; ++v) {
    store.put(
        message(std::string(1, static_cast<char>('a' + v % 5)), static_cast<std::uint64_t>(v)));
    const auto done = static_cast<std::uint8_t>(v);
    if (write(pipe, &done, 1) != 1) _exit(9);
    if (v % 4 == 0) store.sync();
    if (v == kCompactAt) store.compact();
  }
  _exit(0);
}

struct Outcome {
  int puts = 0;
  bool killed = false;
};

Outcome run_until(const fs::path& folder, std::uint64_t die_at) {
  int ends[2];
  if (pipe(ends) != 0) throw std::runtime_error("pipe");
  const pid_t child = fork();
  if (child == 0) work(folder, die_at, ends[1]);
  close(ends[1]);
  Outcome outcome;
  std::uint8_t done = 0;
  while (read(ends[0], &done, 1) == 1) outcome.puts = done;
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  outcome.killed = WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL;
  EXPECT_TRUE(outcome.killed || (WIFEXITED(status) && WEXITSTATUS(status) == 0));
  return outcome;
}

TEST_F(Store, KilledAtEveryChangeOfTheDiskNothingAcknowledgedIsLost) {
  for (std::uint64_t die_at = 1;; ++die_at) {
    const fs::path folder = folder_ / std::to_string(die_at);
    const Outcome outcome = run_until(folder, die_at);
    TileStore store(folder, {});
    for (int k = 0; k < 5; ++k) {
      // The store must have the newest acknowledged message of this key, or the one whose put was
      // interrupted.
      std::uint64_t newest = 0;
      for (int v = 1; v <= outcome.puts; ++v)
        newest = v % 5 == k ? static_cast<std::uint64_t>(v) : newest;
      const std::string name(1, static_cast<char>('a' + k));
      const auto got = store.get(message(name, 1).key);
      if (newest > 0) {
        ASSERT_TRUE(got) << "change " << die_at << ", key " << name;
        const bool under_way = got->rank.version == static_cast<std::uint64_t>(outcome.puts) + 1;
        ASSERT_TRUE(got->rank.version == newest || under_way) << die_at;
      }
      if (got) {
        ASSERT_EQ(got->payload, message(name, got->rank.version).payload) << die_at;
      }
    }
    EXPECT_EQ(store.put(message("z", 1)), PutResult::kStored) << "it goes on";
    fs::remove_all(folder);
    if (!outcome.killed) {
      EXPECT_EQ(outcome.puts, kPuts);
      EXPECT_GT(die_at, 60U) << "puts, syncs, segments and a compaction were all hit";
      break;
    }
  }
}

TEST_F(Store, AFolderThatCantBeHadIsSaid) {
  std::ofstream(folder_ / "file") << "x";
  EXPECT_THROW(TileStore(folder_ / "file", {}), std::system_error);
}

}  // namespace
}  // namespace zloam::store
