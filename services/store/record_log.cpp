#include "store/record_log.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <system_error>
#include <utility>

#include "store/crc32c.hpp"

namespace zloam::store {
namespace {

namespace fs = std::filesystem;
constexpr std::size_t kHead = 8;
// A file that is not complete yet; removed at the start.
constexpr const char* kTemporary = "compaction.tmp";
constexpr const char* kSetAside = ".ignored";
// Attempts to open all files between two compactions of another process.
constexpr int kTries = 10;

std::uint32_t read_u32(const std::uint8_t* p) {
  return static_cast<std::uint32_t>(p[0]) | static_cast<std::uint32_t>(p[1]) << 8 |
         static_cast<std::uint32_t>(p[2]) << 16 | static_cast<std::uint32_t>(p[3]) << 24;
}

void put_u32(std::uint8_t* p, std::uint32_t value) {
  for (int i = 0; i < 4; ++i) p[i] = static_cast<std::uint8_t>(value >> (8 * i));
}

/// Head and body in one buffer, so that a single write appends them and a kill leaves a prefix.
std::vector<std::uint8_t> framed(std::span<const std::uint8_t> body) {
  std::vector<std::uint8_t> bytes(kHead + body.size());
  put_u32(bytes.data(), static_cast<std::uint32_t>(body.size()));
  put_u32(bytes.data() + 4, crc32c(body));
  std::copy(body.begin(), body.end(), bytes.begin() + kHead);
  return bytes;
}

/// Size of the body of the record at the offset; 0: no complete record is there. Empty bodies are
/// invalid, because the zeros that a power failure may leave would pass for one.
std::uint32_t body_size(std::span<const std::uint8_t> bytes, std::size_t at, std::uint32_t limit) {
  if (bytes.size() - at < kHead) return 0;
  const std::uint32_t size = read_u32(bytes.data() + at);
  if (size == 0 || size > limit || bytes.size() - at - kHead < size) return 0;
  const bool good = crc32c(bytes.subspan(at + kHead, size)) == read_u32(bytes.data() + at + 4);
  return good ? size : 0;
}

/// What a kill or a power failure leaves at the end of a log: the begin of one record, then perhaps
/// zeros. Anything else was whole once. A damaged length field may look the same.
bool is_torn_write(std::span<const std::uint8_t> rest, std::uint32_t limit) {
  while (!rest.empty() && rest.back() == 0) rest = rest.first(rest.size() - 1);
  if (rest.size() < kHead) return true;
  const std::uint32_t size = read_u32(rest.data());
  return size > 0 && size <= limit && rest.size() - kHead <= size;
}

/// Numbers of the files <digits><extension>, ascending.
std::vector<std::uint64_t> numbers(const fs::path& folder, const std::string& extension) {
  std::vector<std::uint64_t> found;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() != extension) continue;
    const std::string stem = entry.path().stem().string();
    std::uint64_t n = 0;
    const auto [end, error] = std::from_chars(stem.data(), stem.data() + stem.size(), n);
    if (error == std::errc{} && end == stem.data() + stem.size()) found.push_back(n);
  }
  std::sort(found.begin(), found.end());
  return found;
}

/// Number of files that were set aside, now or earlier.
std::uint64_t count_set_aside(const fs::path& folder) {
  if (!fs::exists(folder)) return 0;
  return static_cast<std::uint64_t>(std::ranges::count_if(
      fs::directory_iterator(folder),
      [](const fs::directory_entry& entry) { return entry.path().extension() == kSetAside; }));
}

/// Name for what is set aside of a file. Numbers are used again, but nothing replaces what an
/// earlier damage left.
fs::path set_aside_name(const fs::path& path) {
  fs::path name = path.string() + kSetAside;
  for (int n = 2; fs::exists(name); ++n) name = path.string() + "." + std::to_string(n) + kSetAside;
  return name;
}

/// Removes the file at the end if it still has this name: what a full disk has left of it would
/// take the room of the next records.
class Temporary {
 public:
  explicit Temporary(fs::path path) : path_(std::move(path)) {}
  ~Temporary() {
    std::error_code ignored;
    fs::remove(path_, ignored);
  }
  Temporary(const Temporary&) = delete;
  Temporary& operator=(const Temporary&) = delete;

 private:
  fs::path path_;
};

/// Writes a file, which replaces one of that name at once.
void write_whole(std::span<const std::uint8_t> bytes, const fs::path& path) {
  const fs::path temporary = path.parent_path() / kTemporary;
  const Temporary removed(temporary);
  AppendFile file(temporary);
  file.append(bytes);
  file.sync();
  file.close();
  rename_file(temporary, path);
}

/// Throws if the file system has less room: an attempt would fill it, again and again.
void need_room(const fs::path& folder, std::uint64_t bytes) {
  std::error_code unknown;
  const fs::space_info space = fs::space(folder, unknown);
  if (unknown || may_have_room(space, bytes)) return;
  throw std::system_error(
      std::make_error_code(std::errc::no_space_on_device),
      "a compaction needs " + std::to_string((bytes >> 20) + 1) + " MiB in " + folder.string());
}

/// Leaves these first bytes of the file. An earlier map may have the file too (a hard link): there
/// it is left unchanged, so that its damage is reported there, too.
void cut_to(std::span<const std::uint8_t> good, const fs::path& path) {
  if (fs::hard_link_count(path) == 1) {
    truncate_file(path, good.size());
  } else {
    write_whole(good, path);
  }
}

}  // namespace

RecordLog::RecordLog(fs::path folder, const LogLimits& limits, const OnRecord& on_record,
                     Access access)
    : folder_(std::move(folder)), access_(access), limits_(limits) {
  if (access_ == Access::kRead) {
    recover(on_record);
    return;
  }
  fs::create_directories(folder_);
  lock_ = std::make_unique<FolderLock>(folder_);
  fs::remove(folder_ / kTemporary);
  recover(on_record);
  open_segment();
}

fs::path RecordLog::path_of(std::uint64_t number, bool base) const {
  std::array<char, 32> name{};
  std::snprintf(name.data(), name.size(), "%08llu.%s", static_cast<unsigned long long>(number),
                base ? "base" : "log");
  return folder_ / name.data();
}

RecordLog::Files RecordLog::files() const {
  Files found;
  const std::vector<std::uint64_t> bases = numbers(folder_, ".base");
  if (!bases.empty()) found.base = bases.back();
  found.segments = numbers(folder_, ".log");
  std::erase_if(found.segments, [&](std::uint64_t n) { return n <= found.base; });
  return found;
}

RecordLog::Files RecordLog::open_files() {
  for (int tries = 1;; ++tries) {
    opened_.clear();
    const Files found = files();
    try {
      if (found.base > 0) opened_.try_emplace({found.base, true}, path_of(found.base, true));
      for (const std::uint64_t n : found.segments) {
        opened_.try_emplace({n, false}, path_of(n, false));
      }
      // A newer base replaces segments, of which some may have been removed before they were listed.
      if (files().base == found.base || tries == kTries) return found;
    } catch (const std::system_error&) {
      if (tries == kTries) throw;
    }
  }
}

void RecordLog::recover(const OnRecord& on_record) {
  const bool writes = access_ == Access::kWrite;
  const Files found = writes ? files() : open_files();
  // Older files remain if a process was killed after it wrote the new base and before it removed
  // the files that the base replaces.
  if (writes) remove_up_to(found.base, true);
  number_ = found.base;
  recovery_.ignored_segments = count_set_aside(folder_);
  recovery_.damaged = recovery_.ignored_segments > 0;
  bool whole = found.base == 0 || read_segment(found.base, true, on_record);
  std::uint64_t before = found.base;
  for (const std::uint64_t n : found.segments) {
    note_missing(before, n);
    before = n;
    if (whole) {
      number_ = n;
      whole = read_segment(n, false, on_record);
      continue;
    }
    const fs::path path = path_of(n, false);
    if (writes) rename_file(path, set_aside_name(path));
    ++recovery_.ignored_segments;
    recovery_.damaged = true;
  }
}

/// Without a base the segments begin with 1.
void RecordLog::note_missing(std::uint64_t before, std::uint64_t next) {
  if (next == before + 1) return;
  const bool is_base = before == 0;
  const std::string first = path_of(is_base ? next - 1 : before + 1, is_base).filename().string();
  const std::string last = path_of(next - 1, is_base).filename().string();
  if (!recovery_.missing.empty()) recovery_.missing += ", ";
  recovery_.missing += first == last ? first : first + " to " + last;
  recovery_.missing_files += is_base ? 1 : next - before - 1;
  recovery_.damaged = true;
}

bool RecordLog::read_segment(std::uint64_t number, bool base, const OnRecord& on_record) {
  const fs::path path = path_of(number, base);
  const auto opened = opened_.find({number, base});
  const std::vector<std::uint8_t> bytes =
      opened == opened_.end() ? ReadFile(path).all() : opened->second.all();
  std::size_t at = 0;
  while (const std::uint32_t size = body_size(bytes, at, limits_.record_bytes)) {
    on_record(std::span(bytes).subspan(at + kHead, size), Place{number, base, at + kHead, size});
    at += kHead + size;
    ++recovery_.records;
  }
  recovery_.bytes += at;
  bytes_ += at;
  if (at == bytes.size()) return true;
  const std::span rest = std::span(bytes).subspan(at);
  recovery_.cut_bytes += rest.size();
  const bool damaged = !is_torn_write(rest, limits_.record_bytes);
  recovery_.damaged = recovery_.damaged || damaged;
  if (access_ == Access::kRead) return false;
  // As evidence, and for whoever wants to rescue it.
  if (damaged) write_whole(rest, set_aside_name(path));
  cut_to(std::span(bytes).first(at), path);
  return false;
}

void RecordLog::open_segment() {
  if (segment_.is_open()) {
    // Segments behind a torn one are set aside at the next start.
    segment_.cut();
    sync();
  }
  AppendFile next(path_of(number_ + 1, false));
  ++number_;
  segment_ = std::move(next);
  sync_folder(folder_);
}

Place RecordLog::append(std::span<const std::uint8_t> body) {
  if (body.empty() || body.size() > limits_.record_bytes) {
    throw std::system_error(std::make_error_code(std::errc::message_size),
                            "a record of " + std::to_string(body.size()) + " bytes");
  }
  const bool is_full = segment_.size() > 0 && segment_.size() + body.size() > limits_.segment_bytes;
  if (!segment_.is_open() || is_full) open_segment();
  const Place place{number_, false, segment_.size() + kHead,
                    static_cast<std::uint32_t>(body.size())};
  segment_.append(framed(body));
  unsynced_ += kHead + body.size();
  bytes_ += kHead + body.size();
  return place;
}

void RecordLog::sync() {
  if (unsynced_ == 0) return;
  try {
    segment_.sync();
  } catch (const std::system_error& e) {
    if (sync_error_.empty()) sync_error_ = e.what();
    throw;
  }
  unsynced_ = 0;
}

std::vector<std::uint8_t> RecordLog::read(const Place& place) const {
  const auto opened = opened_.find({place.file, place.base});
  const std::uint64_t begin = place.offset - kHead;
  std::vector<std::uint8_t> bytes =
      opened == opened_.end()
          ? ReadFile(path_of(place.file, place.base)).part(begin, kHead + place.size)
          : opened->second.part(begin, kHead + place.size);
  // It was whole when it was written, or at the start: the disk may have failed since then.
  if (body_size(bytes, 0, limits_.record_bytes) != place.size) {
    throw std::system_error(
        std::make_error_code(std::errc::io_error),
        "a damaged record in " + path_of(place.file, place.base).filename().string());
  }
  bytes.erase(bytes.begin(), bytes.begin() + kHead);
  return bytes;
}

std::vector<fs::path> RecordLog::close_files() {
  if (segment_.is_open() && segment_.size() > 0) open_segment();
  const Files found = files();
  std::vector<fs::path> paths;
  if (found.base > 0) paths.push_back(path_of(found.base, true));
  for (const std::uint64_t n : found.segments) paths.push_back(path_of(n, false));
  // The new segment, and those of starts after which nothing was stored.
  while (!paths.empty() && fs::file_size(paths.back()) == 0) paths.pop_back();
  return paths;
}

void RecordLog::remove_up_to(std::uint64_t number, bool bases) {
  for (const std::uint64_t n : numbers(folder_, ".log")) {
    if (n <= number) remove_file(path_of(n, false));
  }
  for (const std::uint64_t n : numbers(folder_, ".base")) {
    if (bases && n < number) remove_file(path_of(n, true));
  }
}

void RecordLog::compact(
    std::uint64_t bytes,
    const std::function<void(const std::function<Place(std::span<const std::uint8_t>)>&)>& keep) {
  const fs::path temporary = folder_ / kTemporary;
  fs::remove(temporary);
  need_room(folder_, bytes);
  // No base replaces one of the same number, in which the old places lie.
  if (!segment_.is_open()) open_segment();
  const std::uint64_t base = number_;
  const Temporary removed(temporary);
  AppendFile file(temporary);
  keep([&file, base](std::span<const std::uint8_t> body) {
    const Place place{base, true, file.size() + kHead, static_cast<std::uint32_t>(body.size())};
    file.append(framed(body));
    return place;
  });
  file.sync();
  const std::uint64_t size = file.size();
  file.close();
  // The base replaces this segment too: the next record opens another one.
  sync();
  segment_.close();
  rename_file(temporary, path_of(base, true));
  bytes_ = size;
}

void RecordLog::remove_compacted() { remove_up_to(files().base, true); }

void RecordLog::forget_missing() {
  recovery_.missing.clear();
  recovery_.missing_files = 0;
  // All other damage has left such a file.
  recovery_.damaged = count_set_aside(folder_) > 0;
}

}  // namespace zloam::store
