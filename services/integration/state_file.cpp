#include "integration/state_file.hpp"

#include <fcntl.h>
#include <unistd.h>
#include <xxhash.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <span>
#include <string_view>

#include "common/geometry/write_all.hpp"

namespace zloam::integration {
namespace {

// Written and read on one machine, so the native byte order suffices.
struct Head {
  std::uint64_t checksum = 0, run = 0, sweep = 0, words = 0;
};
// Limit against damaged files: a state has a few thousand bytes.
constexpr std::uint64_t kMostWords = 1 << 20;

std::uint64_t checksum(const Head& head, std::span<const std::uint64_t> words) {
  const std::uint64_t seed = head.run ^ (head.sweep * 3) ^ (head.words << 40);
  return XXH64(words.data(), words.size_bytes(), seed);
}

std::optional<SavedState> read_one(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  Head head;
  if (!file.read(reinterpret_cast<char*>(&head), sizeof head)) return std::nullopt;
  if (head.words > kMostWords) return std::nullopt;
  SavedState state{head.run, head.sweep, std::vector<std::uint64_t>(head.words)};
  const auto bytes = static_cast<std::streamsize>(head.words * sizeof(std::uint64_t));
  if (!file.read(reinterpret_cast<char*>(state.words.data()), bytes)) return std::nullopt;
  if (checksum(head, state.words) != head.checksum) return std::nullopt;
  return state;
}

}  // namespace

StateFile::StateFile(const std::string& path) {
  if (!path.empty()) paths_ = {path + ".0", path + ".1"};
}

std::optional<SavedState> StateFile::read(std::uint64_t run, std::uint64_t sweep) const {
  std::optional<SavedState> newest;
  for (const std::string& path : paths_) {
    auto state = path.empty() ? std::nullopt : read_one(path);
    if (!state || state->run != run || state->sweep > sweep) continue;
    if (!newest || newest->sweep < state->sweep) newest = std::move(state);
  }
  return newest;
}

std::string StateFile::begin() {
  remove();
  for (std::size_t i = 0; i < paths_.size() && !paths_[i].empty(); ++i) {
    descriptors_[i] = ::open(paths_[i].c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0644);
    if (descriptors_[i] < 0) not_begun_ = paths_[i] + ": " + std::strerror(errno);
    if (!not_begun_.empty()) break;
  }
  return not_begun_;
}

std::string StateFile::write(const SavedState& state) {
  const int descriptor = descriptors_[turn_];
  if (descriptor < 0) return not_begun_;
  Head head{0, state.run, state.sweep, state.words.size()};
  head.checksum = checksum(head, state.words);
  std::vector<std::uint64_t> all = {head.checksum, head.run, head.sweep, head.words};
  all.insert(all.end(), state.words.begin(), state.words.end());
  const std::string_view bytes(reinterpret_cast<const char*>(all.data()),
                               all.size() * sizeof all.front());
  // The other file stays intact, even if this write fails.
  if (::lseek(descriptor, 0, SEEK_SET) != 0 || !write_all(descriptor, bytes)) {
    return paths_[turn_] + ": " + std::strerror(errno);
  }
  turn_ = 1 - turn_;
  return {};
}

void StateFile::remove() {
  close();
  not_begun_.clear();
  for (const std::string& path : paths_) {
    if (!path.empty()) ::unlink(path.c_str());
  }
}

void StateFile::close() {
  for (int& descriptor : descriptors_) {
    if (descriptor >= 0) ::close(descriptor);
    descriptor = -1;
  }
}

}  // namespace zloam::integration
