#include "simulator/io/zenoh_sink.hpp"

#include <unistd.h>

#include <chrono>
#include <condition_variable>
#include <mutex>

#include "common/messages/build.hpp"
#include "common/messages/keys.hpp"
#include "common/runtime/session_config.hpp"
#include "common/zenoh/zenoh.hpp"
#include "simulator/io/pacer.hpp"

namespace zloam::simulator {
namespace {

zenoh::Session open_session(const ZenohSinkConfig& config) {
  runtime::ZenohConfig settings;
  settings.base_port = config.base_port;
  settings.listen = config.listen;
  settings.connect = config.connect;
  zenoh::init_log("error");
  return zenoh::Session::open(
      runtime::session_config(settings, runtime::endpoints_of(settings, "simulator")));
}

msg::ImuSample sample_of(const ImuReading& reading, std::int64_t epoch_ns) {
  const auto vec = [](const Eigen::Vector3d& v) { return msg::Vec3(v.x(), v.y(), v.z()); };
  return {epoch_ns + reading.time_ns, vec(reading.force_m_s2), vec(reading.rate_rad_s)};
}

// Publishes on one key and numbers its messages.
class Outlet {
 public:
  Outlet(zenoh::Session& session, const Keys& keys, Key key, bool block)
      : publisher_(session.declare_publisher(
            keys.of(key), {.congestion_control = block ? zenoh::CongestionControl::kBlock
                                                       : zenoh::CongestionControl::kDrop,
                           .priority = zenoh::Priority::kInteractiveHigh,
                           .encoding = encoding_of(key)})) {
    header_.robot = keys.robot();
    header_.sensor = keys.sensor();
    header_.instance = "simulator-" + std::to_string(getpid());
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    header_.run = static_cast<std::uint64_t>(std::chrono::nanoseconds(now).count());
  }

  /// Header of the next message.
  HeaderFields header(std::int64_t stamp_ns, bool last) {
    header_.stamp_ns = stamp_ns;
    header_.end_of_run = last;
    HeaderFields out = header_;
    ++header_.seq;
    ++header_.sweep;
    return out;
  }
  void put(Buffer message) { publisher_.put(zenoh::Bytes::own(std::move(message))); }
  zenoh::Publisher& publisher() { return publisher_; }

 private:
  zenoh::Publisher publisher_;
  HeaderFields header_;
};

class ZenohSink : public Sink {
 public:
  ZenohSink(const ZenohSinkConfig& config, std::int64_t epoch_ns, ImuSource imu)
      : config_(config),
        epoch_ns_(epoch_ns),
        imu_source_(std::move(imu)),
        keys_(config.robot, config.sensor),
        session_(open_session(config)),
        packets_(session_, keys_, Key::kPackets, config.block),
        pacer_(config.rate) {
    if (imu_source_) {
      imu_.emplace(session_, keys_, Key::kImu, config_.block);
    }
    wait_for_reader();
  }

  void put(std::span<const Datagram> datagrams) override {
    for (const Datagram& datagram : datagrams) {
      if (!entries_.empty() &&
          datagram.sent_ns - entries_.front().received_ns() >= config_.batch_ns) {
        publish(false);
      }
      entries_.emplace_back(datagram.sent_ns, static_cast<std::uint32_t>(data_.size()),
                            static_cast<std::uint16_t>(datagram.payload.size()), datagram.port);
      data_.insert(data_.end(), datagram.payload.begin(), datagram.payload.end());
    }
  }

  void close() override {
    publish(true);
    session_.close();
  }

 private:
  void wait_for_reader() {
    struct Readers {
      std::mutex mutex;
      std::condition_variable bell;
      bool there = false;
    };
    // Shared with the callback, which may outlive this function.
    const auto readers = std::make_shared<Readers>();
    packets_.publisher().on_matching([readers](bool matching) {
      const std::lock_guard lock(readers->mutex);
      readers->there = readers->there || matching;
      readers->bell.notify_all();
    });
    std::unique_lock lock(readers->mutex);
    readers->bell.wait_for(lock, std::chrono::duration<double>(config_.wait_s),
                           [&] { return readers->there; });
  }

  void publish(bool last) {
    const std::int64_t sent_ns = entries_.empty() ? epoch_ns_ : entries_.back().received_ns();
    const std::int64_t stamp_ns = entries_.empty() ? epoch_ns_ : entries_.front().received_ns();
    pacer_.wait_for(sent_ns);
    if (imu_) {
      publish_imu(sent_ns - epoch_ns_, last);
    }
    packets_.put(build(packets_.header(stamp_ns, last), PacketsFields{entries_, data_, "VLP-16"}));
    entries_.clear();
    data_.clear();
  }

  void publish_imu(std::int64_t until_ns, bool last) {
    std::vector<msg::ImuSample> samples;
    for (const ImuReading& reading : imu_source_(until_ns)) {
      samples.push_back(sample_of(reading, epoch_ns_));
    }
    if (!samples.empty()) {
      HeaderFields header = imu_->header(samples.front().stamp_ns(), last);
      header.frame = "imu";
      imu_->put(build_imu(header, samples, msg::ClockSource::Synthetic));
    }
  }

  ZenohSinkConfig config_;
  std::int64_t epoch_ns_;
  ImuSource imu_source_;
  Keys keys_;
  zenoh::Session session_;
  Outlet packets_;
  std::optional<Outlet> imu_;
  Pacer pacer_;
  std::vector<msg::PacketEntry> entries_;
  std::vector<std::uint8_t> data_;
};

}  // namespace

std::unique_ptr<Sink> zenoh_sink(const ZenohSinkConfig& config, std::int64_t epoch_ns,
                                 ImuSource imu) {
  return std::make_unique<ZenohSink>(config, epoch_ns, std::move(imu));
}

}  // namespace zloam::simulator
