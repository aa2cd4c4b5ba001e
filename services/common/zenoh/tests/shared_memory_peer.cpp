// The other process of shared_memory_test: connects to the endpoint given, and publishes messages
// of the size given until its standard input is closed. The bytes of message n are all n modulo
// 256.
#include <poll.h>

#include <cstdlib>
#include <exception>
#include <string>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

bool input_closed() {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  return poll(&input, 1, 0) != 0;
}

void run(const std::string& endpoint, std::size_t size) {
  Config config = connecting_config(endpoint);
  config.insert_json5("transport/shared_memory/enabled", "true");
  config.insert_json5("transport/shared_memory/transport_optimization/pool_size", "4194304");
  Session session = Session::open(config);
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  Publisher publisher = session.declare_publisher("test/shm", options);
  wait_matching(publisher);
  for (unsigned n = 0; !input_closed(); ++n) {
    publisher.put(Bytes::own(std::vector<std::uint8_t>(size, static_cast<std::uint8_t>(n))));
  }
}

}  // namespace
}  // namespace zloam::zenoh::test

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  try {
    zloam::zenoh::test::run(argv[1], std::strtoul(argv[2], nullptr, 10));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "shared_memory_peer: %s\n", error.what());
    return 1;
  }
  return 0;
}
