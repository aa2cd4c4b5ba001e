#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

struct ChannelSubscriber::Impl {
  ~Impl() { channel->close(); }  // before the subscriber, which waits for its callbacks

  Subscriber subscriber;
  std::shared_ptr<detail::Channel> channel;
};

Subscriber::Subscriber(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Subscriber::Subscriber(Subscriber&&) noexcept = default;
Subscriber& Subscriber::operator=(Subscriber&&) noexcept = default;
Subscriber::~Subscriber() = default;

ChannelSubscriber::ChannelSubscriber(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ChannelSubscriber::ChannelSubscriber(ChannelSubscriber&&) noexcept = default;
ChannelSubscriber& ChannelSubscriber::operator=(ChannelSubscriber&&) noexcept = default;
ChannelSubscriber::~ChannelSubscriber() = default;

std::optional<Sample> ChannelSubscriber::recv(std::chrono::milliseconds timeout) {
  return impl_->channel->pop(timeout);
}

std::optional<Sample> ChannelSubscriber::try_recv() {
  return impl_->channel->pop(std::chrono::milliseconds(0));
}

std::uint64_t ChannelSubscriber::dropped() const { return impl_->channel->dropped(); }

Subscriber Session::declare_subscriber(std::string_view key,
                                       std::function<void(Sample&&)> callback) {
  auto impl = std::make_unique<Subscriber::Impl>();
  impl->session = impl_;
  void* context = detail::SampleClosure::make(std::move(callback), impl_->errors);
  zloam_subscriber* handle = nullptr;
  detail::check(zloam_session_declare_subscriber(impl_->handle.get(), detail::slice(key),
                                                 detail::call_with_sample, context,
                                                 detail::SampleClosure::drop, &handle),
                key);
  impl->handle.reset(handle);
  return Subscriber(std::move(impl));
}

ChannelSubscriber Session::declare_channel_subscriber(std::string_view key, ChannelKind kind,
                                                      std::size_t capacity) {
  auto channel = std::make_shared<detail::Channel>(kind, capacity);
  {
    const std::lock_guard lock(impl_->mutex);
    std::erase_if(impl_->channels, [](const auto& weak) { return weak.expired(); });
    impl_->channels.push_back(channel);
  }
  Subscriber subscriber =
      declare_subscriber(key, [channel](Sample&& sample) { channel->push(std::move(sample)); });
  return ChannelSubscriber(std::unique_ptr<ChannelSubscriber::Impl>(
      new ChannelSubscriber::Impl{std::move(subscriber), std::move(channel)}));
}

}  // namespace zloam::zenoh
