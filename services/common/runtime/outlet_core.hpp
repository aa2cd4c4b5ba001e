#pragma once
// The runtime's side of one output.

#include <atomic>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "common/messages/keys.hpp"
#include "common/runtime/outlet.hpp"
#include "common/runtime/shared.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

struct OutletSetup {
  Key row = Key::kSweep;
  std::string key;
  std::string robot, sensor, stage, instance, host;
  /// messages published again are sent in slices of this many bytes, not through shared memory
  std::size_t unshared_part = 3071;
  std::size_t keep_messages = 64;
  std::size_t keep_bytes = std::size_t{256} << 20;
  /// revision of the configuration with which a sweep is processed
  std::function<std::uint32_t(std::uint64_t run, std::uint64_t sweep)> config_rev;
  /// this instance's term, for a stage that exists once; null: the cause's
  std::function<std::uint32_t()> term;
  /// true: another instance publishes, and nothing leaves here
  std::shared_ptr<const std::atomic<bool>> muted = std::make_shared<std::atomic<bool>>(false);
};

/// The last messages of one key, exactly as published. Any thread.
class MessageCache {
 public:
  MessageCache(std::size_t messages, std::size_t bytes) : messages_(messages), bytes_(bytes) {}

  struct Entry {
    std::uint64_t run, sweep, seq;
    zenoh::Bytes payload;
    bool replay;
  };
  void put(Entry entry);
  /// The newest message of that sweep.
  std::optional<Entry> find(std::uint64_t run, std::uint64_t sweep) const;
  /// The messages selected by run=R;sweep=a..b or seq=a..b (also a single number), ascending;
  /// nothing for any other text.
  std::vector<Entry> select(std::string_view parameters) const;
  /// In order of arrival.
  std::vector<Entry> all() const;
  std::size_t size() const;

 private:
  std::size_t messages_, bytes_;
  mutable std::mutex mutex_;
  std::deque<Entry> entries_;
  std::size_t held_bytes_ = 0;
};

class OutletCore final : public Outlet {
 public:
  OutletCore(OutletSetup setup, zenoh::Session& session);

  const std::string& key() const override { return setup_.key; }
  bool matching() const override;
  HeaderFields header(const Message& cause) override;
  HeaderFields header(std::int64_t received_ns, std::int64_t started_ns) override;
  void publish(const HeaderFields& header, Buffer message) override;
  void publish_at(const std::string& key, const HeaderFields& header, Buffer message) override;
  /// Answers by number although another instance publishes: that instance is going to ask.
  void answer_in_silence() { answers_in_silence_ = true; }
  bool publish_again(std::uint64_t run, std::uint64_t sweep) override;
  std::uint64_t published() const override { return published_.load(); }

  Key row() const { return setup_.row; }
  std::uint64_t bytes() const { return bytes_.load(); }
  std::uint64_t republished() const { return republished_.load(); }
  struct Published {
    std::uint64_t run = 0, sweep = 0;
    /// it was marked as the run's last
    bool ended = false;
  };
  /// The newest published sweep. Any thread.
  std::optional<Published> last() const;

 private:
  zenoh::PublisherOptions options(bool block) const;
  void put(const zenoh::Bytes& payload, bool replay);
  void answer(zenoh::Query&& query);

  OutletSetup setup_;
  zenoh::Session& session_;
  std::string encoding_;
  MessageCache cache_;
  std::uint64_t seq_ = 0;
  mutable std::mutex last_mutex_;
  std::optional<Published> last_;
  std::atomic<bool> answers_in_silence_{false};
  std::atomic<std::uint64_t> published_{0}, bytes_{0}, republished_{0};
  std::optional<zenoh::Publisher> live_;
  // Declared when a replay is seen: congestion control belongs to a publisher.
  std::optional<zenoh::Publisher> replay_;
  // Last: its callbacks must end before the members they use are destroyed.
  std::optional<zenoh::Queryable> queryable_;
};

}  // namespace zloam::runtime
