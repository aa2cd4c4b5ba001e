#include "integration/journal.hpp"

#include <fcntl.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string_view>
#include <system_error>

#include "common/geometry/write_all.hpp"

namespace zloam::integration {
namespace {

// Written and read on one machine, so the native byte order suffices. The last number is a checksum
// of the others: a power failure may leave zeros, or old bytes of the disk.
constexpr std::size_t kNumbers = 5 + 2 * 12 + 1;
using Record = std::array<std::uint64_t, kNumbers>;

std::uint64_t checksum(const Record& record) {
  return XXH64(record.data(), sizeof record - sizeof record.back(), 0);
}

std::uint64_t* put(std::uint64_t* out, const Pose& pose) {
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) {
      *out++ = std::bit_cast<std::uint64_t>(pose(row, column));
    }
  }
  return out;
}

const std::uint64_t* take(const std::uint64_t* in, Pose& pose) {
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) pose(row, column) = std::bit_cast<double>(*in++);
  }
  return in;
}

Record record_of(const JournalPose& pose) {
  Record record{pose.run, pose.sweep, std::bit_cast<std::uint64_t>(pose.instant_ns),
                pose.odom_epoch, pose.replay};
  put(put(record.data() + 5, pose.T_map_base), pose.T_odom_base);
  record.back() = checksum(record);
  return record;
}

JournalPose pose_of(const Record& record) {
  JournalPose pose;
  pose.run = record[0];
  pose.sweep = record[1];
  pose.instant_ns = std::bit_cast<std::int64_t>(record[2]);
  pose.odom_epoch = static_cast<std::uint32_t>(record[3]);
  pose.replay = record[4] != 0;
  take(take(record.data() + 5, pose.T_map_base), pose.T_odom_base);
  return pose;
}

}  // namespace

bool drop_after(std::vector<JournalPose>& poses, std::uint64_t run, std::uint64_t sweep) {
  const auto last = std::find_if(poses.rbegin(), poses.rend(), [&](const JournalPose& pose) {
    return pose.run == run && pose.sweep == sweep;
  });
  if (last == poses.rend()) return false;
  poses.erase(last.base(), poses.end());
  return true;
}

std::vector<JournalPose> Journal::read() const {
  std::vector<JournalPose> poses;
  std::ifstream file(path_, std::ios::binary);
  Record record;
  while (!path_.empty() && file.read(reinterpret_cast<char*>(record.data()), sizeof record)) {
    if (record.back() != checksum(record)) break;
    poses.push_back(pose_of(record));
  }
  return poses;
}

std::string Journal::keep_unread() const {
  namespace fs = std::filesystem;
  std::error_code error;
  if (path_.empty() || !fs::is_regular_file(path_, error)) return {};
  // Less is what a kill leaves of the first pose.
  const std::uintmax_t bytes = fs::file_size(path_, error);
  if (error || bytes < sizeof(Record) || !read().empty()) return {};
  return set_aside(".unread");
}

std::string Journal::keep_unwritten() {
  if (is_behind()) write_waiting();
  const std::vector<JournalPose> poses = read();
  const bool can_be_repeated = !poses.empty() && poses.back().replay;
  return poses.empty() || can_be_repeated ? std::string() : set_aside(".unwritten");
}

/// Its new name, which no file had; empty: it has the old one still.
std::string Journal::set_aside(const std::string& ending) const {
  std::error_code error;
  std::string name = path_ + ending;
  for (int n = 2; std::filesystem::exists(name, error); ++n) {
    name = path_ + "." + std::to_string(n) + ending;
  }
  return std::rename(path_.c_str(), name.c_str()) == 0 ? name : std::string();
}

std::string Journal::begin(const std::vector<JournalPose>& poses) {
  close();
  if (path_.empty()) return {};
  std::error_code unmade;
  const std::filesystem::path folder = std::filesystem::path(path_).parent_path();
  if (!folder.empty()) std::filesystem::create_directories(folder, unmade);
  // The old journal stays until the new one is complete: this process may be killed too.
  const std::string fresh = path_ + ".new";
  descriptor_ = ::open(fresh.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_APPEND | O_CLOEXEC, 0644);
  if (descriptor_ < 0) {
    return unmade ? folder.string() + ": " + unmade.message() : path_ + ": " + std::strerror(errno);
  }
  std::string error;
  for (const JournalPose& pose : poses) {
    if (error.empty()) error = append(pose);
  }
  if (error.empty() && ::rename(fresh.c_str(), path_.c_str()) != 0) {
    error = path_ + ": " + std::strerror(errno);
  }
  if (!error.empty()) {
    close();
    ::unlink(fresh.c_str());
  }
  return error;
}

std::string Journal::append(const JournalPose& pose) {
  if (descriptor_ < 0) return {};
  const bool was_behind = is_behind();
  waiting_.push_back(pose);
  if (write_waiting() || was_behind) return {};
  return path_ + ": " + std::strerror(errno);
}

/// False: some still wait, and errno says why.
bool Journal::write_waiting() {
  // A record that the attempt before cut short would shift all later ones.
  if (::lseek(descriptor_, 0, SEEK_END) != bytes_ && ::ftruncate(descriptor_, bytes_) != 0) {
    return false;
  }
  for (; !waiting_.empty(); waiting_.pop_front()) {
    const Record record = record_of(waiting_.front());
    const std::string_view bytes(reinterpret_cast<const char*>(record.data()), sizeof record);
    if (!write_all(descriptor_, bytes)) return false;
    bytes_ += static_cast<std::int64_t>(bytes.size());
  }
  return true;
}

void Journal::remove() {
  close();
  if (!path_.empty()) ::unlink(path_.c_str());
}

void Journal::close() {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
  bytes_ = 0;
  waiting_.clear();
}

}  // namespace zloam::integration
