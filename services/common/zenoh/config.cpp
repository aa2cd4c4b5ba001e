#include "common/zenoh/session_impl.hpp"

namespace zloam::zenoh {

struct Config::Impl {
  detail::Handle<zloam_config, zloam_config_drop> handle;
};

namespace detail {

const zloam_config* borrow(const Config& config) { return config.impl()->handle.get(); }

}  // namespace detail

namespace {

Config take(zloam_config* handle) {
  detail::Handle<zloam_config, zloam_config_drop> owned(handle);
  auto impl = std::make_shared<Config::Impl>();
  impl->handle = std::move(owned);
  return Config(std::move(impl));
}

}  // namespace

Config::Config(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}

Config Config::create_default() {
  zloam_config* handle = nullptr;
  detail::check(zloam_config_default(&handle), "configuration");
  Config config = take(handle);
  // Zenoh's default pool of 16 MiB holds too few clouds. Mode "init" creates the pool before the
  // first message.
  const std::string_view shm = "transport/shared_memory/";
  const auto set = [&](std::string_view key, std::string_view value) {
    config.insert_json5(std::string(shm).append(key), value);
  };
  set("enabled", "true");
  set("mode", "\"init\"");
  set("transport_optimization/pool_size", "67108864");
  set("transport_optimization/message_size_threshold", "3072");
  return config;
}

Config Config::from_str(std::string_view json5) {
  zloam_config* handle = nullptr;
  detail::check(zloam_config_from_text(detail::slice(json5), &handle), "configuration");
  return take(handle);
}

Config Config::from_file(const std::string& path) {
  zloam_config* handle = nullptr;
  detail::check(zloam_config_from_file(detail::slice(path), &handle), "configuration " + path);
  return take(handle);
}

void Config::insert_json5(std::string_view key, std::string_view json5_value) {
  detail::check(
      zloam_config_insert(impl_->handle.get(), detail::slice(key), detail::slice(json5_value)),
      "configuration " + std::string(key));
}

}  // namespace zloam::zenoh
