#include "store/tile_store.hpp"

#include <algorithm>
#include <stdexcept>
#include <system_error>

namespace zloam::store {
namespace {

// Layout of a body: kind u8, map_id u64, term u32, version u64, lengths of key and encoding u16
// each, key, encoding, payload. Little endian.
constexpr std::uint8_t kMessage = 1;
constexpr std::size_t kFixed = 1 + 8 + 4 + 8 + 2 + 2;

template <class T>
std::uint8_t* put_number(std::uint8_t* out, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    *out++ = static_cast<std::uint8_t>(static_cast<std::uint64_t>(value) >> (8 * i));
  }
  return out;
}

template <class T>
T take_number(std::span<const std::uint8_t>& in) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) value |= std::uint64_t{in[i]} << (8 * i);
  in = in.subspan(sizeof(T));
  return static_cast<T>(value);
}

std::string take_text(std::span<const std::uint8_t>& in, std::size_t size) {
  std::string text(in.begin(), in.begin() + static_cast<std::ptrdiff_t>(size));
  in = in.subspan(size);
  return text;
}

}  // namespace

std::vector<std::uint8_t> pack(const StoredMessage& m) {
  if (m.key.size() > UINT16_MAX || m.encoding.size() > UINT16_MAX) {
    throw std::length_error("a key or encoding of more than 65535 bytes");
  }
  std::vector<std::uint8_t> out(kFixed + m.key.size() + m.encoding.size() + m.payload.size());
  std::uint8_t* at = put_number(out.data(), kMessage);
  at = put_number(at, m.rank.map_id);
  at = put_number(at, m.rank.term);
  at = put_number(at, m.rank.version);
  at = put_number(at, static_cast<std::uint16_t>(m.key.size()));
  at = put_number(at, static_cast<std::uint16_t>(m.encoding.size()));
  at = std::copy(m.key.begin(), m.key.end(), at);
  at = std::copy(m.encoding.begin(), m.encoding.end(), at);
  std::copy(m.payload.begin(), m.payload.end(), at);
  return out;
}

std::optional<StoredMessage> unpack(std::span<const std::uint8_t> in, bool with_payload) {
  if (in.size() < kFixed || take_number<std::uint8_t>(in) != kMessage) return std::nullopt;
  StoredMessage m;
  m.rank.map_id = take_number<std::uint64_t>(in);
  m.rank.term = take_number<std::uint32_t>(in);
  m.rank.version = take_number<std::uint64_t>(in);
  const std::size_t key = take_number<std::uint16_t>(in);
  const std::size_t encoding = take_number<std::uint16_t>(in);
  if (in.size() < key + encoding) return std::nullopt;
  m.key = take_text(in, key);
  m.encoding = take_text(in, encoding);
  if (with_payload) m.payload.assign(in.begin(), in.end());
  return m;
}

TileStore::TileStore(const std::filesystem::path& folder, const StoreLimits& limits, Access access)
    : limits_(limits),
      log_(
          folder, limits.log,
          [this](std::span<const std::uint8_t> body, const Place& place) {
            on_record(body, place);
          },
          access) {}

void TileStore::on_record(std::span<const std::uint8_t> body, const Place& place) {
  const std::optional<StoredMessage> message = unpack(body, false);
  if (!message) {
    ++unreadable_;
    return;
  }
  const auto found = entries_.find(message->key);
  if (found != entries_.end() && !(found->second.rank < message->rank)) return;
  note(message->key, message->rank, place);
}

void TileStore::note(const std::string& key, const Rank& rank, const Place& place) {
  if (rank.map_id > newest_map_) {
    newest_map_ = rank.map_id;
    std::erase_if(entries_, [this](const auto& e) { return e.second.rank.map_id < newest_map_; });
    live_bytes_ = 0;
    for (const auto& [name, entry] : entries_) live_bytes_ += entry.place.size;
  } else if (rank.map_id < newest_map_) {
    return;
  }
  Entry& entry = entries_[key];
  live_bytes_ += place.size - std::uint64_t{entry.place.size};
  entry = {rank, place};
}

PutResult TileStore::put(const StoredMessage& message) {
  const auto found = entries_.find(message.key);
  const bool known = found != entries_.end() && !(found->second.rank < message.rank);
  if (known || message.rank.map_id < newest_map_) return PutResult::kOld;
  const Place place = log_.append(pack(message));
  lacks_only_older_ = lacks_only_older_ || message.rank.map_id > newest_map_;
  note(message.key, message.rank, place);
  return PutResult::kStored;
}

std::optional<StoredMessage> TileStore::get(const std::string& key) const {
  const auto found = entries_.find(key);
  if (found == entries_.end()) return std::nullopt;
  return unpack(log_.read(found->second.place), true);
}

std::optional<Rank> TileStore::rank(const std::string& key) const {
  const auto found = entries_.find(key);
  if (found == entries_.end()) return std::nullopt;
  return found->second.rank;
}

std::vector<std::string> TileStore::keys() const {
  std::vector<std::string> all;
  for (const auto& [key, entry] : entries_) all.push_back(key);
  return all;
}

bool TileStore::compact_if_due() {
  const auto large = static_cast<double>(live_bytes_) * limits_.garbage_factor;
  const bool is_large =
      log_.bytes() >= limits_.compact_bytes && static_cast<double>(log_.bytes()) >= large;
  if (!is_large && !(lacks_only_older_ && !recovery().missing.empty())) return false;
  compact();
  return true;
}

void TileStore::compact() {
  // Compaction may throw: entries_ keeps the old places until the new file is complete.
  std::map<std::string, Entry> moved = entries_;
  log_.compact(live_bytes_, [&](const std::function<Place(std::span<const std::uint8_t>)>& write) {
    for (auto& [key, entry] : moved) entry.place = write(log_.read(entry.place));
  });
  entries_ = std::move(moved);
  log_.remove_compacted();
  if (!lacks_only_older_) return;
  log_.forget_missing();
  unreadable_ = 0;
}

}  // namespace zloam::store
