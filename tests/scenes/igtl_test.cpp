/// Tests OpenIGTLink messages in both directions against the OpenIGTLink library.
#include <algorithm>
#include <array>
#include <cstring>
#include <igtlImageMessage.h>
#include <igtlMessageHeader.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTransformMessage.h>
#include <igtl_util.h>

#include <catch2/catch.hpp>

#include "palpate/scenes/network/slicer/igtl_message.h"

using namespace palpate;
using namespace palpate::cli;

namespace {

ByteView bytesOf(igtl::MessageBase& message) {
  message.Pack();
  return {static_cast<const std::uint8_t*>(message.GetPackPointer()),
          static_cast<std::size_t>(message.GetPackSize())};
}

/// Checks a complete message and returns its header.
IgtlHead headOf(ByteView bytes) {
  const IgtlHead head = readIgtlHead(bytes.first<kIgtlHead>());
  CHECK(head.size == bytes.size() - kIgtlHead);
  CHECK(head.crc == igtlCrc(bytes.subspan(kIgtlHead)));
  return head;
}

/// Unpacks a palpate message with the library.
template <class Message>
typename Message::Pointer unpacked(const Bytes& bytes) {
  const auto header = igtl::MessageHeader::New();
  header->InitPack();
  REQUIRE(bytes.size() >= static_cast<std::size_t>(header->GetPackSize()));
  std::memcpy(header->GetPackPointer(), bytes.data(), kIgtlHead);
  header->Unpack();
  const auto message = Message::New();
  message->SetMessageHeader(header);
  message->AllocatePack();
  REQUIRE(static_cast<std::size_t>(message->GetPackBodySize()) == bytes.size() - kIgtlHead);
  std::memcpy(message->GetPackBodyPointer(), bytes.data() + kIgtlHead, bytes.size() - kIgtlHead);
  constexpr int kCheck = 1;
  CHECK((message->Unpack(kCheck) & igtl::MessageHeader::UNPACK_BODY) != 0);
  return message;
}

constexpr std::int64_t kNow = 1'700'000'000'250'000'000;

}  // namespace

TEST_CASE("the OpenIGTLink library can read the server's messages", "[igtl]") {
  const auto transform =
      unpacked<igtl::TransformMessage>(igtlTransform("PalpateHand", kNow, Vec3(1.5, -2.25, 300)));
  CHECK(transform->GetDeviceName() == std::string("PalpateHand"));
  igtl::Matrix4x4 matrix;
  transform->GetMatrix(matrix);
  CHECK(matrix[0][3] == 1.5F);
  CHECK(matrix[1][3] == -2.25F);
  CHECK(matrix[2][3] == 300.0F);
  CHECK(matrix[0][0] == 1.0F);
  CHECK(matrix[1][0] == 0.0F);
  auto stamp = igtl::TimeStamp::New();
  transform->GetTimeStamp(stamp);
  CHECK(stamp->GetTimeStamp() == Approx(1'700'000'000.25).epsilon(1e-15));

  const auto string = unpacked<igtl::StringMessage>(igtlString("PalpateForce", kNow, "0 -1.5 2"));
  CHECK(string->GetString() == std::string("0 -1.5 2"));
  CHECK(string->GetEncoding() == 3);

  const auto status =
      unpacked<igtl::StatusMessage>(igtlStatus("Palpate", kNow, IgtlCode::kDenied, "no"));
  CHECK(status->GetCode() == igtl::StatusMessage::STATUS_ACCESS_DENIED);
  CHECK(status->GetStatusString() == std::string("no"));
}

TEST_CASE("the server can read messages of the OpenIGTLink library", "[igtl]") {
  const auto transform = igtl::TransformMessage::New();
  transform->SetDeviceName("PalpateSteer");
  transform->SetPosition(7.0F, -8.0F, 9.5F);
  const ByteView moved = bytesOf(*transform);
  CHECK(headOf(moved).type == "TRANSFORM");
  CHECK(headOf(moved).name == "PalpateSteer");
  CHECK(readIgtlTransform(moved.subspan(kIgtlHead)) == Vec3(7.0, -8.0, 9.5));

  const auto string = igtl::StringMessage::New();
  string->SetDeviceName("PalpateCommand");
  string->SetString("cut");
  const ByteView said = bytesOf(*string);
  CHECK(headOf(said).type == "STRING");
  CHECK(readIgtlString(said.subspan(kIgtlHead)) == "cut");
}

TEST_CASE("an image of the OpenIGTLink library keeps its size, placement and range of values",
          "[igtl]") {
  const auto image = igtl::ImageMessage::New();
  image->SetDeviceName("head");
  image->SetDimensions(4, 3, 2);
  image->SetSpacing(2.0F, 3.0F, 5.0F);
  image->SetScalarTypeToInt16();
  image->SetEndian(igtl_is_little_endian() != 0 ? igtl::ImageMessage::ENDIAN_LITTLE
                                                : igtl::ImageMessage::ENDIAN_BIG);
  image->SetCoordinateSystem(GENERATE(1, 2));
  int whole[3]{4, 3, 2};  // NOLINT: the library takes C arrays
  int nowhere[3]{};       // NOLINT
  image->SetSubVolume(whole, nowhere);
  // The image's axis i is along y, and its axis j against x, in RAS or in LPS.
  float along_i[3]{0, 1, 0};   // NOLINT
  float along_j[3]{-1, 0, 0};  // NOLINT
  float along_k[3]{0, 0, 1};   // NOLINT
  image->SetNormals(along_i, along_j, along_k);
  image->SetOrigin(10.0F, 20.0F, 30.0F);
  image->AllocateScalars();
  std::array<std::int16_t, 24> values{};
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = static_cast<std::int16_t>(100 * static_cast<int>(i) - 700);
  }
  std::memcpy(image->GetScalarPointer(), values.data(), sizeof values);
  const ByteView bytes = bytesOf(*image);
  const IgtlHead head = headOf(bytes);
  CHECK(head.type == "IMAGE");
  const ByteView body = bytes.subspan(kIgtlHead);
  const IgtlImage read = readIgtlImage(head, {body.begin(), body.end()});
  CHECK(read.size == std::array<std::int64_t, 3>{4, 3, 2});
  CHECK(read.components == 1);
  const double sign = image->GetCoordinateSystem() == 2 ? -1.0 : 1.0;
  CHECK(read.axes.col(0).isApprox(Vec3(0, sign * 2, 0)));
  CHECK(read.axes.col(1).isApprox(Vec3(-sign * 3, 0, 0)));
  CHECK(read.axes.col(2).isApprox(Vec3(0, 0, 5)));
  // The image's centre, in voxels: (1.5, 1, 0.5).
  const Vec3 middle = read.origin + read.axes * Vec3(1.5, 1.0, 0.5);
  CHECK(middle.isApprox(Vec3(sign * 10, sign * 20, 30)));
  const auto volume = volumeOf(read);
  CHECK(volume->info().lowest == -700.0);
  CHECK(volume->info().highest == 1600.0);
}
