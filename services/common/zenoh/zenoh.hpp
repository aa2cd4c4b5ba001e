#pragma once
// Eclipse Zenoh for C++20, in zenoh-cpp's terms, over the Rust crate in bridge/ (C ABI, zenoh
// =1.10.2).
//
// Rules that hold for everything here:
//  - Errors are thrown as ZenohError with Zenoh's own message; nothing unwinds into or out of Rust.
//  - Handles are movable, not copyable.
//    Destroying one undeclares it and waits for its running callbacks, so a callback may use its
//    captures until then.
//    Never destroy an entity inside its own callback.
//  - Callbacks run on Zenoh's threads: pass the sample to a queue and return. An exception that
//    leaves a callback is caught, counted (callback_exceptions()) and passed to the session's error
//    handler.
//  - No static objects: main owns the Session. Entities keep it open, so their order does not
//    matter.

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace zloam::zenoh {

class ZenohError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Payload of a message: reference-counted, immutable; a copy of the handle copies no bytes.
class Bytes {
 public:
  Bytes();
  /// One copy of the bytes.
  static Bytes copy_of(std::span<const std::uint8_t> data);
  static Bytes copy_of(std::string_view text);
  /// No copy: takes an owner with data() and size() (std::vector, flatbuffers::DetachedBuffer),
  /// which is destroyed once, on any thread, when Zenoh's last reference goes.
  template <class Owner>
  static Bytes own(Owner&& owner);

  std::size_t size() const;
  bool is_shared_memory() const;
  /// False once shared memory may have been written again: its publisher's pool reclaims memory
  /// that no holder confirmed for 100 ms (a stalled or starved process), even if referenced. If it
  /// is true after the last byte was read, all bytes read are valid.
  bool is_intact() const;
  /// The bytes in place, or nothing when they arrived in several fragments.
  std::optional<std::span<const std::uint8_t>> contiguous() const;
  /// Copies all fragments to dst, which must hold size() bytes.
  void copy_to(std::uint8_t* dst) const;
  std::string to_string() const;
  /// A copy in slices of at most `part` bytes. Slices below the threshold of the implicit shared
  /// memory are sent through the socket.
  Bytes in_parts(std::size_t part) const;

  // Implementation detail, shared by the classes below.
  struct Impl;
  explicit Bytes(std::shared_ptr<Impl> impl);
  const std::shared_ptr<Impl>& impl() const { return impl_; }

 private:
  static Bytes from_owner(const std::uint8_t* data, std::size_t size, void* context,
                          void (*drop)(void*));
  std::shared_ptr<Impl> impl_;
};

enum class CongestionControl : std::uint8_t { kDrop = 0, kBlock = 1 };
enum class Priority : std::uint8_t {
  kRealTime = 1,
  kInteractiveHigh = 2,
  kInteractiveLow = 3,
  kDataHigh = 4,
  kData = 5,
  kDataLow = 6,
  kBackground = 7
};
enum class SampleKind : std::uint8_t { kPut = 0, kDelete = 1 };

/// A received message; owns its payload, may be moved out of the callback.
struct Sample {
  std::string key;
  Bytes payload;
  Bytes attachment;
  std::string encoding;
  SampleKind kind = SampleKind::kPut;
  Priority priority = Priority::kData;
  CongestionControl congestion_control = CongestionControl::kDrop;
  bool express = false;
};

/// Zenoh's JSON5 configuration; keys as in its commented default file.
class Config {
 public:
  static Config create_default();
  static Config from_str(std::string_view json5);
  static Config from_file(const std::string& path);
  void insert_json5(std::string_view key, std::string_view json5_value);

  struct Impl;
  explicit Config(std::shared_ptr<Impl> impl);
  const std::shared_ptr<Impl>& impl() const { return impl_; }

 private:
  std::shared_ptr<Impl> impl_;
};

struct PublisherOptions {
  CongestionControl congestion_control = CongestionControl::kDrop;
  Priority priority = Priority::kData;
  bool express = false;
  bool reliable = true;
  std::string encoding;
};

class Publisher {
 public:
  Publisher(Publisher&&) noexcept;
  Publisher& operator=(Publisher&&) noexcept;
  ~Publisher();
  /// May block under CongestionControl::kBlock while a reader is slow.
  void put(const Bytes& payload, const Bytes& attachment = {});
  /// Subscribers see a sample of SampleKind::kDelete; a storage forgets the key.
  void delete_resource();
  /// Whether at least one subscriber matches now.
  bool matching() const;
  /// Called with each change of matching().
  void on_matching(std::function<void(bool)> callback);
  const std::string& key() const;

  struct Impl;
  explicit Publisher(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

/// A callback subscriber (plain or liveliness).
class Subscriber {
 public:
  Subscriber(Subscriber&&) noexcept;
  Subscriber& operator=(Subscriber&&) noexcept;
  ~Subscriber();

  struct Impl;
  explicit Subscriber(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

/// A query to be answered, from any thread; it ends when this object is destroyed.
class Query {
 public:
  Query(Query&&) noexcept;
  Query& operator=(Query&&) noexcept;
  ~Query();
  const std::string& key() const;
  /// The part of the selector behind '?', e.g. "run=1;sweep=3..5".
  const std::string& parameters() const;
  const Bytes& payload() const;
  void reply(std::string_view key, const Bytes& payload, std::string_view encoding = {},
             const Bytes& attachment = {});
  void reply_error(const Bytes& payload);

  struct Impl;
  explicit Query(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

class Queryable {
 public:
  Queryable(Queryable&&) noexcept;
  Queryable& operator=(Queryable&&) noexcept;
  ~Queryable();

  struct Impl;
  explicit Queryable(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

/// One answer to a get: a sample, or the payload of an error reply ("Timeout" when a queryable did
/// not answer in time).
struct Reply {
  std::optional<Sample> sample;
  Bytes error;
  bool ok() const { return sample.has_value(); }
};

struct GetOptions {
  std::chrono::milliseconds timeout{2000};
  Bytes payload;
  /// All matching queryables answer (true), or the best one (false).
  bool target_all = true;
};

class LivelinessToken {
 public:
  LivelinessToken(LivelinessToken&&) noexcept;
  LivelinessToken& operator=(LivelinessToken&&) noexcept;
  ~LivelinessToken();

  struct Impl;
  explicit LivelinessToken(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

class Session {
 public:
  using ErrorHandler = std::function<void(std::string_view)>;

  /// Throws when the configuration is wrong or a listen endpoint is taken.
  static Session open(const Config& config);
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;
  ~Session();

  /// Closes within the deadline; false when Zenoh did not return in time (bad link), after which
  /// the process should end at once. Entities stay safe to destroy.
  bool close(std::chrono::milliseconds deadline = std::chrono::milliseconds(3000));
  /// 32 hexadecimal digits or fewer.
  std::string zid() const;
  /// The other ends of its links, such as tcp/192.168.1.5:7447. For a link opened by the other side
  /// the port is arbitrary.
  std::vector<std::string> links() const;

  Publisher declare_publisher(std::string_view key, const PublisherOptions& options = {});
  Subscriber declare_subscriber(std::string_view key, std::function<void(Sample&&)> callback);
  Queryable declare_queryable(std::string_view key, std::function<void(Query&&)> callback,
                              bool complete = true);
  /// Put without a publisher.
  void put(std::string_view key, const Bytes& payload, const PublisherOptions& options = {});
  void delete_resource(std::string_view key);
  /// Calls on_reply for each answer and on_done once after the last (or the timeout); returns at
  /// once.
  void get(std::string_view selector, std::function<void(Reply&&)> on_reply,
           std::function<void()> on_done, const GetOptions& options = {});
  /// Waits for all answers, so it must not be called in a callback.
  std::vector<Reply> get(std::string_view selector, const GetOptions& options = {});

  LivelinessToken declare_liveliness_token(std::string_view key);
  /// kPut when a token appears, kDelete when it disappears; with history also for existing tokens.
  Subscriber declare_liveliness_subscriber(std::string_view key,
                                           std::function<void(Sample&&)> callback,
                                           bool history = true);
  /// Keys of the tokens alive now.
  std::vector<std::string> liveliness_get(std::string_view key, std::chrono::milliseconds timeout);

  /// Receives exceptions from callbacks; default: counted only.
  void set_error_handler(ErrorHandler handler);
  std::uint64_t callback_exceptions() const;

  struct Impl;

 private:
  explicit Session(std::shared_ptr<Impl> impl);
  std::shared_ptr<Impl> impl_;
};

/// Zenoh's own log (Rust) to standard error at this level unless RUST_LOG sets another; once per
/// process.
void init_log(std::string_view fallback_level);

template <class Owner>
Bytes Bytes::own(Owner&& owner) {
  using Stored = std::decay_t<Owner>;
  auto stored = std::make_unique<Stored>(std::forward<Owner>(owner));
  const auto* data = reinterpret_cast<const std::uint8_t*>(stored->data());
  const std::size_t size = stored->size();
  return from_owner(data, size, stored.release(), [](void* p) { delete static_cast<Stored*>(p); });
}

}  // namespace zloam::zenoh
