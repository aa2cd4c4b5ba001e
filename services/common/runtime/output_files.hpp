#pragma once
// A stage's files in its output folder: each run has its own, no file is replaced by one with less
// data, and files of others are never touched. A list in the folder records the owners.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace zloam::runtime {

class OutputFiles {
 public:
  /// The run that the files belong to.
  struct Run {
    std::uint64_t id = 0;
    bool replay = false;
    /// poses or points: more of one run replaces less, and any run a file without any
    std::uint64_t count = 0;
  };

  /// Empty folder: nothing can be saved. `list`: name of the list's file.
  OutputFiles(std::string folder, std::string list);

  const std::string& folder() const { return folder_; }

  /// Suffix before the extension of a run's files: empty for the first run, then _2, _3 ... A
  /// replay replaces the files of another replay.
  std::string suffix(const Run& run, const std::vector<std::string>& names) const;
  /// Full path of a file with the suffix.
  std::string path(const std::string& name, const std::string& suffix = {}) const;

  /// Records a written file as this run's. Empty, or a sentence that says what failed.
  std::string made(const std::string& path, const Run& run);

  struct Place {
    std::string path;
    /// why it may not be written; empty: it may
    std::string error;
  };
  /// Where a command may write: below the folder, through no symbolic link, over no foreign file.
  Place place(const std::string& asked) const;
  /// The same for a file in a folder that place() gave.
  std::string in_the_way(const std::string& path) const;

 private:
  struct Entry {
    Run run;
    std::uint64_t bytes = 0;
    std::int64_t changed_ns = 0;
  };
  using Entries = std::map<std::string, Entry>;

  struct Stat {
    bool regular = false;
    std::uint64_t bytes = 0;
    std::int64_t changed_ns = 0;
  };

  static std::optional<Stat> stat_of(const std::string& path);
  static bool is_as_made(const Stat& there, const Entries& entries, const std::string& name);
  Entries read() const;
  std::string name_of(const std::string& path) const;
  bool is_free(const std::string& path, const Run& run, const Entries& entries) const;

  std::string folder_;
  std::string list_;
  /// files written by this process: name -> run
  std::map<std::string, std::uint64_t> written_;
  /// Those of which the list could not be written, as on a full disk: the next attempt replaces
  /// them, instead of writing another file beside them.
  Entries unlisted_;
};

}  // namespace zloam::runtime
