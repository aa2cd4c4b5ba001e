#include "common/runtime/output_files.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>

#include "common/geometry/atomic_file.hpp"

namespace zloam::runtime {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

bool begins_with(const fs::path& path, const fs::path& start) {
  const auto [s, p] = std::mismatch(start.begin(), start.end(), path.begin(), path.end());
  return s == start.end() && p != path.end();
}

fs::path without_slash(const fs::path& path) {
  return path.has_filename() ? path : path.parent_path();
}

}  // namespace

/// Nothing if there is no such file. Links are not followed.
std::optional<OutputFiles::Stat> OutputFiles::stat_of(const std::string& path) {
  struct stat about {};
  if (::lstat(path.c_str(), &about) != 0) return std::nullopt;
  return Stat{S_ISREG(about.st_mode), static_cast<std::uint64_t>(about.st_size),
              std::int64_t{about.st_mtim.tv_sec} * 1'000'000'000 + about.st_mtim.tv_nsec};
}

OutputFiles::OutputFiles(std::string folder, std::string list)
    : folder_(std::move(folder)), list_(std::move(list)) {}

std::string OutputFiles::path(const std::string& name, const std::string& suffix) const {
  const fs::path plain(name);
  return (fs::path(folder_) / (plain.stem().string() + suffix + plain.extension().string()))
      .string();
}

/// The file's name in the list: its path relative to the folder.
std::string OutputFiles::name_of(const std::string& path) const {
  return fs::absolute(path)
      .lexically_normal()
      .lexically_proximate(without_slash(fs::absolute(folder_).lexically_normal()))
      .string();
}

OutputFiles::Entries OutputFiles::read() const {
  Entries entries = unlisted_;
  // Read as a whole first: the parser passes the exception of a disk error on.
  std::ostringstream text;
  text << std::ifstream(fs::path(folder_) / list_).rdbuf();
  const Json list = Json::parse(text.str(), nullptr, false);
  if (!list.is_object()) return entries;
  for (const auto& [name, e] : list.items()) {
    if (unlisted_.contains(name)) continue;
    try {
      entries[name] = {{e.at("run").get<std::uint64_t>(), e.at("replay").get<bool>(),
                        e.at("count").get<std::uint64_t>()},
                       e.at("bytes").get<std::uint64_t>(),
                       e.at("changed_ns").get<std::int64_t>()};
    } catch (const Json::exception&) {
      // An entry of an unknown form does not show that this program wrote the file: skip it.
    }
  }
  return entries;
}

bool OutputFiles::is_as_made(const Stat& there, const Entries& entries, const std::string& name) {
  const auto known = entries.find(name);
  return known != entries.end() && there.regular && there.bytes == known->second.bytes &&
         there.changed_ns == known->second.changed_ns;
}

bool OutputFiles::is_free(const std::string& path, const Run& run, const Entries& entries) const {
  const auto there = stat_of(path);
  if (!there) return true;
  const std::string name = name_of(path);
  if (!is_as_made(*there, entries, name)) return false;
  const Run& before = entries.at(name).run;
  // Written by command before anything had come.
  if (before.count == 0) return true;
  if (run.replay) return before.replay;
  const auto own = written_.find(name);
  const bool by_us = own != written_.end() && own->second == run.id;
  return before.id == run.id && !before.replay && (by_us || before.count <= run.count);
}

std::string OutputFiles::suffix(const Run& run, const std::vector<std::string>& names) const {
  const Entries entries = read();
  for (int number = 1;; ++number) {
    std::string suffix = number == 1 ? "" : "_" + std::to_string(number);
    const bool free = std::all_of(names.begin(), names.end(), [&](const std::string& name) {
      return is_free(path(name, suffix), run, entries);
    });
    if (free) return suffix;
  }
}

std::string OutputFiles::made(const std::string& path, const Run& run) {
  Entries entries = read();
  written_[name_of(path)] = run.id;
  const auto there = stat_of(path);
  if (there) entries[name_of(path)] = {run, there->bytes, there->changed_ns};
  if (there) unlisted_[name_of(path)] = entries[name_of(path)];
  Json list = Json::object();
  for (const auto& [name, e] : entries) {
    if (!stat_of((fs::path(folder_) / name).string())) continue;
    list[name] = {{"run", e.run.id},
                  {"replay", e.run.replay},
                  {"count", e.run.count},
                  {"bytes", e.bytes},
                  {"changed_ns", e.changed_ns}};
  }
  // The file is written already, so a name that is not UTF-8 may not throw either.
  const std::string text = list.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
  std::string error = write_file_atomically((fs::path(folder_) / list_).string(), text);
  if (error.empty()) unlisted_.clear();
  return error;
}

OutputFiles::Place OutputFiles::place(const std::string& asked) const {
  if (folder_.empty()) return {"", "no output folder is configured: nothing can be saved"};
  if (asked.find('\0') != std::string::npos) return {"", "a path without zero bytes is expected"};
  std::error_code error;
  const fs::path root = without_slash(fs::absolute(folder_, error).lexically_normal());
  const fs::path real = fs::weakly_canonical(root, error);
  const fs::path wanted = without_slash((root / asked).lexically_normal());
  const bool by_real = !begins_with(wanted, root) && begins_with(wanted, real);
  if (asked.empty() || (!by_real && !begins_with(wanted, root))) {
    return {"", asked + " is not below the output folder " + root.string()};
  }
  fs::path at = root;
  for (const fs::path& part : wanted.lexically_relative(by_real ? real : root)) {
    at /= part;
    if (fs::is_symlink(fs::symlink_status(at, error))) {
      return {"", at.string() + " is a symbolic link, and none is followed"};
    }
  }
  return {at.string(), ""};
}

std::string OutputFiles::in_the_way(const std::string& path) const {
  const auto there = stat_of(path);
  if (!there || is_as_made(*there, read(), name_of(path))) return {};
  return path + " is there and was not written by this program: it stays as it is";
}

}  // namespace zloam::runtime
